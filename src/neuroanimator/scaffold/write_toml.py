"""Write the TOML file that `neuroanimator new` proposes for a model, a step function or recordings."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from neuroanimator.definitions.model import Definition
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.parsing.names import SYSTEM_PATTERN
from neuroanimator.scaffold.defaults import usual_name
from neuroanimator.scaffold.function import propose_function
from neuroanimator.scaffold.model import Proposal, propose
from neuroanimator.scaffold.recording import propose_recording
from neuroanimator.storage.files import write_whole
from neuroanimator.systems import SYSTEMS
from neuroanimator.systems.rigid.joints import FEATURES
from neuroanimator.systems.trusted_files import trust_file
from neuroanimator.text import quoted

TITLES = {
    "physics": "How the physics is stepped. Speed-ups are measured against step and integrator.\n"
    "# truth teaches; fine is the reference of every error, at most a tenth of the step.",
    "state": "How the network sees each joint.\n"
    f"# hinge: {', '.join(FEATURES['hinge'][:3])}; slide: {', '.join(FEATURES['slide'][:2])}; ball: ball; free: free, placed.\n"
    "# cyclic: where it stands does not matter, how fast it moves does; free: nor which way it faces; placed: both matter.",
    "frame": "What of the root's position matters. ground: its height; probes: x, y, z, radius of feet [m];\n"
    "# contacts: what of the whole body may touch the ground, and joints that may reach their stops;\n"
    "# symmetries: mirrors and like limbs, by which every example stands for several;\n"
    "# planar: joints x, y, heading of a root that moves in a plane, where position and heading do not matter.",
    "control": "The least and the largest value of each actuator.",
    "holding": "What holds the model at rest; where controls cease, they cease to this.",
    "sampling": "Random starts of training runs, around the state of rest; a share of them near it.\n"
    "# reset_share: of runs that begin just at rest or at a keyframe, but for reset_noise;\n"
    "# warm_up: random driving before the others are recorded [s]; tilt: of a free root [rad].",
    "sampling.position": "Where they begin [rad or m]: from the first to the second number,\n"
    "# or as far as one number to either side of rest.",
    "sampling.velocity": "Standard deviation [rad/s or m/s], as seen in trial runs.",
}
"""Each table of a model's TOML file stands under its title."""

PART_TITLES = {
    "physics": "The step the function is called with, or the sampling interval [s].\n"
    "# Of a function: truth_step is the dt that teaches, fine_step the one every error is measured against.",
    "state": "The state, part by part. feature: plain, sine (an angle that may turn all the way round) or\n"
    "# cyclic (where it is does not matter, how fast it moves does); rate: the part that is its rate of change.",
    "control": "The control, part by part, with its least (low) and greatest (high) values.",
    "sampling": "Random starts: a share of them near rest, spread by a share of the others' spread.",
}
"""Each table of the TOML file of a step function or recordings stands under its title."""

PROPOSERS = {".py": propose_function, ".csv": propose_recording, ".npz": propose_recording}
"""A file with one of these endings is no model: its definition is proposed by this function."""

TOP_KEYS = (
    "name",
    "kind",
    "model",
    "tree",
    "base",
    "passive",
    "keyframe",
    "file",
    "batched",
    "substeps",
    "sensors",
)
"""These keys belong to no table; TOML wants them before the first one."""

GROUP_HINT = """
# Limbs, or other parts of the body, and their joints: with them 'train --network hierarchy' works.
# [groups]
# limb = ["JOINT"]
"""
"""This comment stands at the end of a model's TOML file."""

GOAL_HINT = """
# A goal for 'neuroanimator control': a state, or part of one, to be in at the end.
# [goals.there]
# seconds = 2.0
# reach = { "PART" = [1.0] }
# within = { "PART" = 0.1 }
# PARTs: """
"""This comment ends a TOML file that may name goals; the names of the parts follow it."""


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
) -> tuple[Path, Proposal]:
    """Write the definition proposed for `model` and return (its path, the proposal).

    `model` is a file, or a Gymnasium environment's id, whose MJCF is then copied beside the TOML. A step function is
    run to see what it does. `keyframe`, `base`, `passive` and `tree` are as in `propose`; the system is called `name`, or
    after the file or the id. Beside the model or above it `out` names it by its path from there, elsewhere by its absolute path.

    Raises ArgumentError if `out` exists and `force` is not set, if it does not lie beside a step function or
    recordings, or if `name` is none or taken; BadFileError for what cannot be emulated.
    """
    _check_name(name)
    source = Path(model)
    reset_noise = 0.0
    path = out or source.with_suffix(".toml")
    if not source.suffix:
        source, reset_noise = _copy_from_gymnasium(model, path.parent)
        name = name or usual_name(Path(model))
    if path.exists() and not force:
        raise ArgumentError(
            f"{path} exists, and may hold your edits. --force overwrites it; --out names another."
        )
    if source.suffix in PROPOSERS:
        if path.parent.resolve() != source.parent.resolve():
            raise ArgumentError(
                f"{path}: the TOML file must lie beside {source.name}, in {source.parent or '.'}."
            )
        _refuse_model_options(source, keyframe, base, passive, tree)
        proposal = _propose_without_model(source)
        changes = {}
    else:
        proposal = propose(
            source,
            keyframe=keyframe,
            base=base,
            passive=passive,
            tree=tree,
            reset_noise=reset_noise,
        )
        changes = {"model": _seen_from(path, source)}
        if tree is not None:
            changes["tree"] = _seen_from(path, tree.resolve())
    if name:
        changes["name"] = name
    proposal = replace(proposal, definition=proposal.definition.model_copy(update=changes))
    write_whole(path, as_toml(proposal).encode())
    return path, proposal


def _check_name(name: str) -> None:
    """Raise ArgumentError for a name that no system of a user's can have; none at all is well."""
    if name and not re.fullmatch(SYSTEM_PATTERN, name):
        raise ArgumentError(
            f"name: wanted letters, digits, _ and -, at most 40, came {quoted(name)}."
        )
    if name in SYSTEMS:
        raise ArgumentError(f"name: '{name}' is a system of the package. Choose another.")


def checked_base(text: str) -> Literal["fixed", "free"]:
    """Return what the command line says of a URDF's base; ArgumentError lists what may be said."""
    if text == "fixed" or text == "free":
        return text
    raise ArgumentError(f"base: wanted fixed or free, came {quoted(text)}.")


def _refuse_model_options(
    source: Path, keyframe: str, base: str, passive: tuple[str, ...], tree: Path | None
) -> None:
    """Raise ArgumentError for options that only a model file can have."""
    if keyframe or base != "fixed" or passive or tree is not None:
        raise ArgumentError(
            f"{source.name} is no MuJoCo model, so it has neither keyframes, base, joints nor meshes. Leave --keyframe, "
            "--base, --passive and --tree out."
        )


def _seen_from(toml: Path, path: Path) -> str:
    """Return how a TOML file names a path: from its own folder if it lies in there, else as an absolute path."""
    folder = toml.parent.resolve()
    place = path.parent.resolve() / path.name
    if place.is_relative_to(folder):
        return place.relative_to(folder).as_posix()
    return place.as_posix()


def _propose_without_model(source: Path) -> Proposal:
    """Return the proposal for a step function or recordings, by the ending of the file."""
    # Whoever asks for a definition of a step function asks for it to be run.
    trust_file(source)
    definition, notes, warnings = PROPOSERS[source.suffix](source)
    parts = [part.name for part in definition.state]
    return Proposal(definition, notes, parts, warnings)


def _copy_from_gymnasium(name: str, folder: Path) -> tuple[Path, float]:
    """Copy the MJCF of the environment `name` into `folder`; return its path there, and the noise of the resets."""
    from neuroanimator.gym import mjcf_of
    from neuroanimator.gym.models import default_of

    original = mjcf_of(name)
    target = folder / original.name
    if target.exists() and target.read_bytes() != original.read_bytes():
        raise BadFileError(f"{target} exists and is another model. Use another folder.")
    write_whole(target, original.read_bytes())
    return target, default_of(name, "reset_noise_scale") or 0.0


def as_toml(proposal: Proposal) -> str:
    """Return the proposal as TOML text, each table under a comment that says what it is."""
    definition = proposal.definition
    is_model = isinstance(definition, Definition)
    values = definition.model_dump(mode="json", exclude_unset=not is_model)
    if is_model:
        for key in ("tree", "passive"):
            if not values[key]:
                del values[key]
    top = {key: values.pop(key) for key in TOP_KEYS if key in values}
    values.pop("goals", None)
    values.pop("groups", None)
    titles = PART_TITLES
    source = top.get("file")
    if is_model:
        titles = TITLES
        source = Path(top["model"]).name
    lines = [
        f"# How NeuroAnimator sees {source}. Edit what you know better; every line is checked when used."
    ]
    for key, value in top.items():
        lines.append(_line(key, value, proposal.notes.get(key, "")))
    for name, table in values.items():
        if isinstance(table, list):
            lines += _array_of_tables(name, table, proposal.notes, titles)
        else:
            lines += _table(name, table, proposal.notes, titles)
    if is_model:
        lines += GROUP_HINT.splitlines()
    text = "\n".join(lines) + "\n"
    if "goals" in type(definition).model_fields and definition.control:
        text += GOAL_HINT + ", ".join(proposal.parts) + "\n"
    return text


def _array_of_tables(
    name: str, tables: list[dict[str, Any]], notes: dict[str, str], titles: dict[str, str]
) -> list[str]:
    """Return the lines of the tables `[[name]]`, under one title and all notes on them; none if there are none."""
    if not tables:
        return []
    lines = ["", f"# {titles[name]}"]
    for key, note in notes.items():
        if key.startswith(f"{name}."):
            lines.append(f"# {key}: {note}")
    for table in tables:
        lines.append(f"[[{name}]]")
        for key, value in table.items():
            lines.append(_line(key, value, ""))
        lines.append("")
    # No empty line after the last.
    return lines[:-1]


def _table(
    name: str, table: dict[str, Any], notes: dict[str, str], titles: dict[str, str]
) -> list[str]:
    """Return the lines of the table `[name]` and of those inside it; none if it is empty."""
    if not table:
        return []
    lines = ["", f"# {titles[name]}", f"[{name}]"]
    inner_lines = []
    for key, value in table.items():
        if isinstance(value, dict):
            inner_lines += _table(f"{name}.{key}", value, notes, titles)
        else:
            lines.append(_line(key, value, notes.get(f"{name}.{key}", "")))
    return lines + inner_lines


def _line(key: str, value: Any, note: str) -> str:
    """Return `key = value`, with the note as a comment if there is one."""
    name = key
    is_bare_key = key.replace("_", "").replace("-", "").isalnum() and key.isascii()
    if not is_bare_key:
        name = json.dumps(key)
    line = f"{name} = {json.dumps(value, ensure_ascii=False)}"
    if note:
        line += f"  # {note}"
    return line
