"""The verb `doctor`: say what this machine has and what is missing."""

from __future__ import annotations

EXAMPLE = "neuroanimator doctor"

NEEDED_DISK = 1.0
"""A dataset of the usual size needs up to this much disk [GB]."""

PACKAGES = ("neuroanimator", "jax", "equinox", "mujoco", "numpy")
"""The versions of these packages are told."""


def run() -> None:
    """Check this machine and say what is missing and how to get it."""
    import platform
    import shutil
    from importlib.metadata import version

    import jax

    from neuroanimator.backend import backend_in_words
    from neuroanimator.export.film.video import HOW_TO_GET_GL, graphics_backend
    from neuroanimator.terminal import print_rows

    rows: list[tuple[str, object]] = [("Python", platform.python_version())]
    rows += [(name, version(name)) for name in PACKAGES]
    rows += [
        ("JAX runs on", ", ".join(str(device) for device in jax.devices())),
        ("video drawn by", graphics_backend() or HOW_TO_GET_GL),
    ]
    rows.append(("emulators run in", backend_in_words()))
    free = shutil.disk_usage(".").free / 1e9
    note = ""
    if free <= NEEDED_DISK:
        note = " (a dataset needs up to 1 GB: make room)"
    rows.append(("free disk", f"{free:.1f} GB{note}"))
    print_rows(rows)
