"""Files as an attacker would write them: sound in every byte, sealed, and with something of one's own in them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from neuroanimator.files.atomic import read_tensors, write_tensors
from neuroanimator.files.zoo import find_emulator

POLICY = Path(__file__).parents[1] / "golden" / "fish.policy.safetensors"

Change = Callable[[dict[str, Any]], object]

BELL = "import pathlib\npathlib.Path({mark!r}).touch()\n"
"""Python code that leaves a mark."""

HOSTILE_TEXTS = {
    "C out of a comment": "arm */ __attribute__((constructor)) static void go(void) { } /*",
    "C preprocessor": "arm\n#include </etc/passwd>",
    "script": "<script>alert(1)</script>",
    "image with a handler": "<img src=x onerror=alert(1)>",
    "entity": "arm&lt;",
    "formula": "=HYPERLINK(1)",
    "formula with a plus": "+1",
    "formula with a minus": "-1",
    "formula with an at": "@SUM(A1)",
    "comma": "arm,leg",
    "quote": 'arm"leg',
    "line break": "arm\nleg",
    "carriage return": "arm\rleg",
    "tab": "\tarm",
    "NUL": "arm\x00",
    "escape code": "\x1b]0;owned\x07",
    "C1 escape code": "\x9b31m",
    "right to left": "arm\u202egpj.exe",
    "zero width": "arm\u200b",
    "line separator": "arm\u2028leg",
    "markup": "[red]arm[/red]",
    "dollar": "$\\frac{1}{0}$",
    "half a surrogate pair": "\ud800",
    "long": "a" * 100_000,
    "nothing": "",
}
"""What each would do where a name is shown."""

NO_TEXTS: dict[str, Any] = {
    "number": 3,
    "list": ["arm"],
    "table": {"arm": 1},
    "null": None,
    "true": True,
}


def forged_emulator(target: Path, change: Change, name: str = "pendulum-50") -> Path:
    """Write a shipped emulator to `target` after `change` of its metadata, sealed anew."""
    return _forged(find_emulator(name), target, change, "emulator")


def forged_policy(target: Path, change: Change) -> Path:
    """Write the golden policy to `target` after `change` of its metadata, sealed anew."""
    return _forged(POLICY, target, change, "policy")


def _forged(source: Path, target: Path, change: Change, kind: str) -> Path:
    tensors, metadata = read_tensors(source, kind)
    del metadata["sha256"]
    change(metadata)
    write_tensors(target, tensors, metadata)
    return target
