"""Somebody's model becomes a TOML file to edit."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from neuroanimator.definitions.model import Definition
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.scaffold.function import propose_function
from neuroanimator.scaffold.model import Proposal, propose
from neuroanimator.scaffold.recording import propose_recording
from neuroanimator.storage.files import write_whole
from neuroanimator.systems import SYSTEMS
from neuroanimator.systems.rigid.joints import FEATURES
from neuroanimator.systems.trusted_files import trust_file

TITLES = {
    "physics": "How the physics is stepped. Speed-ups are measured against step and integrator.\n"
    "# truth teaches; fine is the reference of every error, at most a tenth of the step.",
    "state": "How the network sees each joint.\n"
    f"# hinge: {', '.join(FEATURES['hinge'][:3])}; slide: {', '.join(FEATURES['slide'][:2])}; ball: ball; free: free.\n"
    "# cyclic: where it stands does not matter, how fast it moves does.",
    "frame": "What of the root's position matters. ground: its height; probes: x, y, z, radius of feet [m];\n"
    "# planar: joints x, y, heading of a root that moves in a plane, where position and heading do not matter.",
    "control": "The least and the largest value of each actuator.",
    "sampling": "Random starts of training runs, around the state of rest (keyframe 'home', if the model has one).\n"
    "# warm_up: random driving before a run is recorded [s]; tilt: of a free root [rad].",
    "sampling.position": "Half the width of the spread [rad or m].",
    "sampling.velocity": "Standard deviation [rad/s or m/s], as seen in trial runs.",
}
"""What stands above each table of the TOML file."""

PART_TITLES = {
    "physics": "The step the function is called with, or the sampling interval [s].\n"
    "# Of a function: truth_step is the dt that teaches, fine_step the one every error is measured against.",
    "state": "The state, part by part. feature: plain, sine (an angle that may turn all the way round) or\n"
    "# cyclic (where it is does not matter, how fast it moves does); rate: the part that is its rate of change.",
    "control": "The control, part by part, with its least (low) and greatest (high) values.",
    "sampling": "Random starts: a share of them near rest, spread by a share of the others' spread.",
}
"""The same for systems without a model file."""

OTHER_DOORS = {".py": propose_function, ".csv": propose_recording, ".npz": propose_recording}
"""What is not a model: a step function, recordings."""

GROUP_HINT = """
# Limbs, or other parts of the body, and their joints: with them 'train --network hierarchy' works.
# [groups]
# limb = ["JOINT"]
"""

GOAL_HINT = """
# A goal for 'neuroanimator control': a state, or part of one, to be in at the end.
# [goals.there]
# seconds = 2.0
# reach = { "PART" = [1.0] }
# within = { "PART" = 0.1 }
# PARTs: """


def write_definition(
    model: str, out: Path | None = None, *, force: bool = False
) -> tuple[Path, Proposal]:
    """Write the definition proposed for `model` and return (its path, the proposal).

    `model` is a file, or a Gymnasium environment's id, whose MJCF is then copied beside the TOML. A step function is
    run to see what it does.
    """
    source = Path(model)
    if not source.suffix:
        source = _copy_from_gymnasium(model, out.parent if out else Path())
    path = out or source.with_suffix(".toml")
    if path.exists() and not force:
        raise ArgumentError(
            f"{path} exists, and may hold your edits. --force overwrites it; --out names another."
        )
    if path.parent.resolve() != source.parent.resolve():
        raise ArgumentError(
            f"{path}: the TOML file must lie beside the model, in {source.parent or '.'}."
        )
    proposal = _propose(source)
    if proposal.definition.name in SYSTEMS:
        raise ArgumentError(
            f"'{proposal.definition.name}' is a system of the package. Rename {source.name}."
        )
    write_whole(path, as_toml(proposal).encode())
    return path, proposal


def _propose(source: Path) -> Proposal:
    if source.suffix not in OTHER_DOORS:
        return propose(source)
    trust_file(source)  # whoever asks for a definition of a step function asks for it to be run
    definition, notes = OTHER_DOORS[source.suffix](source)
    return Proposal(definition, notes, [part.name for part in definition.state])


def _copy_from_gymnasium(name: str, folder: Path) -> Path:
    from neuroanimator.gym import mjcf_of

    original = mjcf_of(name)
    target = folder / original.name
    if target.exists() and target.read_bytes() != original.read_bytes():
        raise BadFileError(f"{target} exists and is another model. Use another folder.")
    write_whole(target, original.read_bytes())
    return target


def as_toml(proposal: Proposal) -> str:
    """Return the proposal as TOML text, each table under a comment that says what it is."""
    definition = proposal.definition
    is_model = isinstance(definition, Definition)
    values = definition.model_dump(mode="json", exclude_unset=not is_model)
    top = {
        key: values.pop(key)
        for key in ("name", "kind", "model", "file", "batched", "substeps", "sensors")
        if key in values
    }
    values.pop("goals", None)
    values.pop("groups", None)
    source, titles = (top["model"], TITLES) if is_model else (top["file"], PART_TITLES)
    lines = [
        f"# How NeuroAnimator sees {source}. Edit what you know better; every line is checked when used."
    ]
    lines += [_line(key, value, proposal.notes.get(key, "")) for key, value in top.items()]
    for name, table in values.items():
        write: Any = _parts if isinstance(table, list) else _table
        lines += write(name, table, proposal.notes, titles)
    lines += GROUP_HINT.splitlines() if is_model else []
    hint = GOAL_HINT + ", ".join(proposal.parts) + "\n"
    return "\n".join(lines) + "\n" + (hint if "goals" in type(definition).model_fields else "")


def _parts(
    name: str, parts: list[dict[str, Any]], notes: dict[str, str], titles: dict[str, str]
) -> list[str]:
    lines = [
        "",
        f"# {titles[name]}",
        *(f"# {key}: {note}" for key, note in notes.items() if key.startswith(f"{name}.")),
    ]
    for part in parts:
        lines += [f"[[{name}]]", *(_line(key, value, "") for key, value in part.items()), ""]
    return lines[:-1]


def _table(
    name: str, table: dict[str, Any], notes: dict[str, str], titles: dict[str, str]
) -> list[str]:
    if not table:
        return []
    lines = ["", f"# {titles[name]}", f"[{name}]"]
    lines += [
        _line(key, value, notes.get(f"{name}.{key}", ""))
        for key, value in table.items()
        if not isinstance(value, dict)
    ]
    for key, value in table.items():
        if isinstance(value, dict):
            lines += _table(f"{name}.{key}", value, notes, titles)
    return lines


def _line(key: str, value: Any, note: str) -> str:
    name = (
        key
        if key.replace("_", "").replace("-", "").isalnum() and key.isascii()
        else json.dumps(key)
    )
    return f"{name} = {json.dumps(value, ensure_ascii=False)}" + (f"  # {note}" if note else "")
