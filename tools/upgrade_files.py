"""Rewrite the shipped emulators and policies to today's format: other names, the same numbers.

    python -m tools.upgrade_files FOLDER...

Nothing of an older format was ever released. Each file is read, its names are changed, and it is written again in place;
`tests/golden` holds the files' earlier predictions. Tensors used to be named by the paths of fields; `TENSORS` and
`FIELDS` hold the older names of each field.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax

from neuroanimator.control.policies.policy import Policy
from neuroanimator.emulator.description import blank
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.tensors import emulator_leaves
from neuroanimator.files.atomic import digest, read_tensors, write_tensors

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


FIELDS = {
    ".encoding.": ".modes.",
    ".limits": ".reach",
}
"""Fields of today's emulators that had other names when tensors were named by them."""


def names_by_path(tree: Any, leaves_of: Callable[[Any], dict[str, Any]]) -> dict[str, str]:
    """Return today's name of every array of `tree` by the path of its field, as files had it."""
    paths, structure = jax.tree_util.tree_flatten_with_path(tree)
    old_names = []
    for path, _ in paths:
        old_name = jax.tree_util.keystr(path)
        for today, before in FIELDS.items():
            old_name = old_name.replace(today, before)
        old_names.append(old_name)
    numbered = jax.tree_util.tree_unflatten(structure, range(len(paths)))
    return {old_names[number]: name for name, number in leaves_of(numbered).items()}


def in_todays_words(name: str) -> str:
    """Return the path of a field with the words it has today."""
    words = re.compile("|".join(sorted(TENSORS, key=len, reverse=True)))
    return words.sub(lambda match: TENSORS[match[0]], name)


def upgrade(path: Path) -> None:
    """Rewrite the file at `path`."""
    kind = "policy" if path.name.endswith(".policy.safetensors") else "emulator"
    old_format, new_format = FORMATS[kind]
    tensors, metadata = read_tensors(path, kind)
    metadata.pop("sha256", None)
    if metadata["format"] == old_format:
        metadata = renamed(metadata)
        tensors = {in_todays_words(name): tensor for name, tensor in tensors.items()}
    metadata["format"] = new_format
    if kind == "policy":
        metadata["emulator"]["format"] = FORMATS["emulator"][1]
        tree = jax.eval_shape(
            lambda: Policy._blank(metadata, blank(metadata["emulator"], Emulator))
        )
        names = names_by_path(tree, Policy.leaves)
    else:
        tree = jax.eval_shape(lambda: blank(metadata, Emulator))
        names = names_by_path(tree, emulator_leaves)
    if set(tensors) == set(names.values()):
        print(f"{path.name}: in today's words already")
        return
    tensors = {names[name]: tensor for name, tensor in tensors.items()}
    if kind == "policy":
        carried = {
            name.removeprefix("emulator."): tensor
            for name, tensor in tensors.items()
            if name.startswith("emulator.")
        }
        metadata["emulator_sha256"] = digest(carried)
    write_tensors(path, tensors, metadata)
    print(f"{path.name}: written in format {new_format}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER")
    for folder in parser.parse_args().folders:
        for path in sorted(folder.glob("*.safetensors")):
            upgrade(path)


if __name__ == "__main__":
    main()
