"""`doctor`: is everything here?"""

from __future__ import annotations

EXAMPLE = "neuroanimator doctor"


def run() -> None:
    """Check this machine and say what is missing and how to get it."""
    import platform
    import shutil
    from importlib.metadata import version

    import jax

    from neuroanimator.export.film.video import HOW_TO_GET_GL, graphics_backend
    from neuroanimator.terminal import print_rows

    backend = graphics_backend()
    free = shutil.disk_usage(".").free / 1e9
    print_rows(
        [
            ("Python", platform.python_version()),
            *(
                (name, version(name))
                for name in ("neuroanimator", "jax", "equinox", "mujoco", "numpy")
            ),
            ("JAX runs on", ", ".join(str(device) for device in jax.devices())),
            ("video drawn by", backend or HOW_TO_GET_GL),
            (
                "free disk",
                f"{free:.1f} GB" + ("" if free > 1 else " (a dataset needs up to 1 GB: make room)"),
            ),
        ]
    )
