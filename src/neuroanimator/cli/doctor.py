"""The verb `doctor`: report what this machine has and what is missing."""

from __future__ import annotations

import platform
import re
import shutil
from importlib.metadata import PackageNotFoundError, distribution, requires, version

import jax

from neuroanimator.cli.studio import HOW_TO_GET_STUDIO
from neuroanimator.codegen.backend import backend_in_words
from neuroanimator.film.graphics import HOW_TO_GET_GL, graphics_backend
from neuroanimator.terminal import Rows, print_rows

EXAMPLE = "neuroanimator doctor"

NEEDED_DISK = 1.0
"""Maximum disk space of a dataset of the usual size [GB]."""

EXTRAS = {
    "compiler": "emulators in C where there is no gcc or clang",
    "gym": "Gymnasium environments",
    "onnx": "export to .onnx",
    "ray": "several machines, with Ray",
    "s3": "datasets in S3",
    "studio": "the studio, in the browser",
    "usd": "export to .usdc and .usdz",
    "wasm": "export to .wasm; your own emulators in the studio",
}
"""Purpose of each extra of the package, by name."""

HOW_TO_GET = {"studio": HOW_TO_GET_STUDIO}
"""How to install the extras that no package index has."""

PACKAGES = ("neuroanimator", "jax", "equinox", "mujoco", "numpy")
"""Packages whose versions are printed."""


def run() -> None:
    """Check this machine and say what is missing and how to get it."""
    rows: Rows = [("Python", platform.python_version())]
    rows += [(name, version(name)) for name in PACKAGES]
    rows += [
        ("JAX runs on", ", ".join(str(device) for device in jax.devices())),
        ("video rendered by", graphics_backend() or HOW_TO_GET_GL),
    ]
    rows.append(("emulators run in", backend_in_words()))
    free = shutil.disk_usage(".").free / 1e9
    note = ""
    if free <= NEEDED_DISK:
        note = " (a dataset needs up to 1 GB: make room)"
    rows.append(("free disk", f"{free:.1f} GB{note}"))
    for extra, purpose in EXTRAS.items():
        there = "yes"
        if not _is_there(extra):
            usual = f"pip install 'neuroanimator[{extra}]'"
            there = f"no: {HOW_TO_GET.get(extra, usual)}"
        rows.append((f"extra {extra}", f"{there} ({purpose})"))
    print_rows(rows)


def _is_there(extra: str) -> bool:
    """Return whether all packages of the `extra` are installed."""
    for requirement in requires("neuroanimator") or []:
        if re.search(rf"extra == ['\"]{extra}['\"]", requirement):
            name = re.split(r"[^\w.-]", requirement, maxsplit=1)[0]
            try:
                distribution(name)
            except PackageNotFoundError:
                return False
    return True
