"""The TOML file that `neuroanimator new` proposes for a model, a step function or recordings."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from neuroanimator.definitions.soft import SOLID_ENDING, MeshReading
from neuroanimator.definitions.task import TaskTable
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.files.atomic import write_whole
from neuroanimator.files.names import SYSTEM_PATTERN
from neuroanimator.files.tables import check_table
from neuroanimator.files.zoo import SHIPPED_SYSTEMS
from neuroanimator.scaffold.defaults import usual_name
from neuroanimator.scaffold.function import propose_function
from neuroanimator.scaffold.model import propose
from neuroanimator.scaffold.proposal import Proposal, as_toml
from neuroanimator.scaffold.recording import propose_recording
from neuroanimator.scaffold.soft import propose_soft
from neuroanimator.systems.trusted_files import trust_file
from neuroanimator.text import listed, quoted

KINDS = {
    ".py": "step functions",
    ".csv": "recordings",
    ".npz": "recordings",
    ".obj": "meshes",
    SOLID_ENDING: "meshes",
}
"""Kinds of files other than MuJoCo's models, by suffix."""

OPTIONS = {
    "MuJoCo models": ("keyframe", "base", "passive", "tree"),
    "meshes": ("unit", "up", "keep", "character"),
    "recordings": ("resample", "velocities"),
}
"""Options of a kind of file alone."""


def write_definition(
    model: str,
    out: Path | None = None,
    *,
    force: bool = False,
    keyframe: str = "",
    base: Literal["fixed", "free"] = "fixed",
    passive: tuple[str, ...] = (),
    name: str = "",
    tree: Path | None = None,
    unit: str = "",
    up: str = "",
    keep: str = "",
    character: Path | None = None,
    resample: bool = False,
    velocities: bool = False,
) -> tuple[Path, Proposal]:
    """Write the definition proposed for `model` and return (its path, the proposal).

    `model` is a file, or a Gymnasium environment's id, whose MJCF is then copied beside the TOML. A step function is
    called in trial runs. `keyframe`, `base`, `passive` and `tree` are as in `propose`, `unit`, `up` and `keep` as in a
    mesh's `MeshReading`, `character` as in `propose_soft`, `resample` and `velocities` as in `propose_recording`; the system
    is called `name`, or after the file or the id. Beside the model or above it, `out` names it by its relative path,
    elsewhere by its absolute path.

    Raises ArgumentError if `out` exists and `force` is not set, if it does not lie beside a step function or
    recordings, or if `name` is invalid or taken; BadFileError for what cannot be emulated.
    """
    if name:
        _check_name(name)
    source = Path(model)
    path = out or source.with_suffix(".toml")
    reset_noise = 0.0
    task = None
    resets = None
    if not source.suffix:
        source, task, reset_noise, resets = _copy_from_gymnasium(model, path.parent)
        name = name or usual_name(Path(model))
    if path.exists() and not force:
        raise ArgumentError(
            f"{path} exists, and may hold your edits. --force overwrites it; --out names another."
        )
    kind = KINDS.get(source.suffix, "MuJoCo models")
    reading = {"unit": unit, "up": up, "keep": keep}
    options = reading | {
        "character": character is not None,
        "resample": resample,
        "velocities": velocities,
        "keyframe": keyframe,
    }
    options |= {"base": base != "fixed", "passive": passive, "tree": tree is not None}
    _refuse_others(source.name, kind, [name for name, value in options.items() if value])
    changes: dict[str, Any] = {"name": name} if name else {}
    if task is not None:
        changes["task"] = task
    if kind == "MuJoCo models":
        proposal = propose(
            source,
            keyframe=keyframe,
            base=base,
            passive=passive,
            tree=tree,
            reset_noise=reset_noise,
            resets=resets,
        )
        changes["model"] = _seen_from(path, source)
        if tree is not None:
            changes["tree"] = _seen_from(path, tree.resolve())
    elif kind == "meshes":
        for file in (source, character or source):
            _refuse_elsewhere(path, file)
        given = {key: value for key, value in reading.items() if value}
        proposal = propose_soft(source, check_table(given, source.name, MeshReading), character)
    else:
        _refuse_elsewhere(path, source)
        # Proposing a step function's definition runs the file: the user asks for both.
        trust_file(source)
        if kind == "recordings":
            proposal = propose_recording(source, resample=resample, velocities=velocities)
        else:
            proposal = propose_function(source)
    proposal = replace(proposal, definition=proposal.definition.model_copy(update=changes))
    write_whole(path, as_toml(proposal).encode())
    return path, proposal


def _refuse_elsewhere(toml: Path, file: Path) -> None:
    """Raise ArgumentError if the TOML file is not beside the file that it names."""
    if toml.parent.resolve() != file.parent.resolve():
        raise ArgumentError(
            f"{toml}: the TOML file must be beside {file.name}, in {file.parent or '.'}."
        )


def _check_name(name: str) -> None:
    """Raise ArgumentError for a name that a user's system cannot have."""
    if not re.fullmatch(SYSTEM_PATTERN, name):
        raise ArgumentError(
            f"name: wanted letters, digits, _ and -, at most 40, got {quoted(name)}."
        )
    if name in SHIPPED_SYSTEMS:
        raise ArgumentError(f"name: '{name}' is a system of the package. Choose another.")


def checked_base(text: str) -> Literal["fixed", "free"]:
    """Return a URDF's base as given on the command line; ArgumentError lists the valid ones."""
    if text == "fixed" or text == "free":
        return text
    raise ArgumentError(f"base: wanted fixed or free, got {quoted(text)}.")


def _seen_from(toml: Path, path: Path) -> str:
    """Return a path for a TOML file: relative to its folder if it lies in there, else absolute."""
    folder = toml.parent.resolve()
    place = path.parent.resolve() / path.name
    if place.is_relative_to(folder):
        return place.relative_to(folder).as_posix()
    return place.as_posix()


def _refuse_others(file: str, kind: str, given: list[str]) -> None:
    """Raise ArgumentError if an option of another kind of file is `given`."""
    for other, names in OPTIONS.items():
        wrong = [f"--{name}" for name in names if name in given]
        if wrong and other != kind:
            raise ArgumentError(f"{file}: {listed(wrong)} are for {other}. Leave them out.")


def _copy_from_gymnasium(
    name: str, folder: Path
) -> tuple[Path, TaskTable | None, float, Float[np.ndarray, "B S"] | None]:
    """Copy the MJCF of the environment `name` into `folder`; return its path there, its task, reset noise, and resets."""
    from neuroanimator.gym import mjcf_of
    from neuroanimator.gym.locomotion import gymnasium_task
    from neuroanimator.gym.models import default_of, reset_states

    original = mjcf_of(name)
    target = folder / original.name
    if target.exists() and target.read_bytes() != original.read_bytes():
        raise BadFileError(f"{target} exists and is another model. Use another folder.")
    write_whole(target, original.read_bytes())
    task = None
    if default_of(name, "forward_reward_weight") is not None:
        task = gymnasium_task(name)
    return target, task, default_of(name, "reset_noise_scale") or 0.0, reset_states(name)
