"""Rewrite the shipped emulators and policies to today's format: other words, the same numbers.

    python benchmarks/upgrade_files.py FOLDER...

Nothing of an older format was ever released. Each file is read, its names are changed, and it is written again in place;
`tests/golden` holds what the files predicted before.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

from neuroanimator.storage.files import digest, read_tensors, write_tensors

FORMATS = {"emulator": (4, 5), "policy": (1, 2)}
"""Format before and after."""
KEYS = {
    "weighs": "has_gravity",
    "pushes": "external_forces",
    "response": "time_constant",
    "turn": "orientation",
    "place": "position",
    "follow": "binding",
    "place_modes": "position_modes",
    "speed_modes": "velocity_modes",
}
"""Keys of the metadata and what they are called now."""
PARTS = {
    "place": "position",
    "turn": "orientation",
    "spin": "angular_velocity",
    "speed": "velocity",
}
"""Last words of names of state parts, such as `root.position`."""
TENSORS = {
    "mean_place": "mean_position",
    "mean_speed": "mean_velocity",
    "places": "positions",
    "speeds": "velocities",
    "odd_places": "odd_positions",
    "odd_speeds": "odd_velocities",
}


def renamed(value: Any) -> Any:
    """Return `value` (JSON) with keys and names in today's words."""
    if isinstance(value, dict):
        return {KEYS.get(key, key): renamed(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [renamed(entry) for entry in value]
    if isinstance(value, str):
        match = re.fullmatch(r"(.+)\.(place|turn|spin|speed)", value)
        if match:
            return f"{match[1]}.{PARTS[match[2]]}"
        return "lag" if value == "follower" else value
    return value


def upgrade(path: Path) -> None:
    """Rewrite the file at `path`."""
    kind = "policy" if path.name.endswith(".policy.safetensors") else "emulator"
    old, new = FORMATS[kind]
    tensors, metadata = read_tensors(path, kind)
    if metadata["format"] != old:
        print(f"{path.name}: format {metadata['format']}, left alone")
        return
    metadata = renamed(metadata)
    metadata.pop("sha256", None)
    words = re.compile("|".join(sorted(TENSORS, key=len, reverse=True)))
    tensors = {
        words.sub(lambda match: TENSORS[match[0]], name): tensor for name, tensor in tensors.items()
    }
    metadata["format"] = new
    if kind == "policy":
        inner = {
            name.removeprefix(".emulator"): tensors[name]
            for name in tensors
            if name.startswith(".emulator.")
        }
        metadata["emulator"]["format"] = FORMATS["emulator"][1]
        metadata["emulator_sha256"] = digest(inner)
    write_tensors(path, tensors, metadata)
    print(
        f"{path.name}: format {old} → {new}, {len(json.dumps(metadata)):,} characters of metadata"
    )


if __name__ == "__main__":
    for folder in sys.argv[1:]:
        for path in sorted(Path(folder).glob("*.safetensors")):
            upgrade(path)
