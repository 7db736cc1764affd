"""Sources of the motions that `animate` draws: a policy, a school, paths, controls, or chance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.animation.motion import (
    Drive,
    controlled_drive,
    default_drive,
    named_start,
    random_drive,
)
from neuroanimator.animation.path_drive import movers_of, path_drive
from neuroanimator.animation.recorded_path import RecordedPath, paths_of_nodes
from neuroanimator.cli.formats import emulator_for
from neuroanimator.cli.usage import is_given
from neuroanimator.control.policies.school import school_of
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.trust_summary import summary_of
from neuroanimator.errors import ArgumentError
from neuroanimator.export.csv_file import read_controls
from neuroanimator.export.programs.formats import POLICY_ENDING
from neuroanimator.files.glb import read_glb
from neuroanimator.physics import tied_system
from neuroanimator.state.start import read_starts
from neuroanimator.terminal import phase
from neuroanimator.text import print_line, quoted


class MotionOptions(NamedTuple):
    """The options of `animate` that say what moves; one that is not given is None or off."""

    emulator: str
    out: list[Path]
    seconds: float | None
    seed: int | None
    controls: Path | None
    path: list[str] | None
    path_speed: float | None
    start: list[str] | None
    command: list[str] | None
    in_emulator: bool
    school: int | None
    trust: bool
    hybrid: bool
    threshold: float | None
    system: Path | None

    @property
    def policy(self) -> Path | None:
        """The policy file that moves the body, if one does."""
        if self.school is None and self.emulator.endswith(POLICY_ENDING):
            return Path(self.emulator)
        return None


class SourcedMotion(NamedTuple):
    """What a source gives."""

    emulator: Emulator
    states: Sequence[Float[np.ndarray, "K S"]]
    """The trajectory of each body."""
    made_by: str = "emulator"
    """Origin of the motion, as exports state it."""
    scores: Float[np.ndarray, " T"] | None = None
    """Score of each super step, if films are to show them."""
    rows: Sequence[tuple[str, object]] = ()
    """What to print about it."""


def motion_of(options: MotionOptions) -> SourcedMotion:
    """Return the motion of the first source that is given; refuse options that do not go with it."""
    given = {name for name in (*options._fields, "policy") if is_given(getattr(options, name))}
    for kind, (names, reason) in REFUSED_BESIDE.items():
        if kind in given:
            _refuse(given, names, reason)
    for kinds, names, reason in APPLY_TO:
        if not given.intersection(kinds):
            _refuse(given, names, reason)
    source = next((source for source in SOURCES if source in given), "random")
    return SOURCES[source](options)


def _refuse(given: set[str], names: Sequence[str], reason: str) -> None:
    for name in names:
        if name in given:
            raise ArgumentError(f"{name.replace('_', '-')}: {reason}")


def _of_school(options: MotionOptions) -> SourcedMotion:
    assert options.school is not None
    with phase("loading"):
        model = emulator_for(options.out, options.emulator)
    with phase("emulating"):
        swimmer, motions = school_of(model, options.school, options.seconds, options.seed or 0)
    return SourcedMotion(swimmer, list(motions))


def _of_policy(options: MotionOptions) -> SourcedMotion:
    """Return the motion on command, or that of an episode as in learning."""
    with phase("loading"):
        from neuroanimator.cli.policy_returns import commanded_motion, policy_motion  # with MuJoCo

    policy = options.policy
    assert policy is not None
    is_inside = options.in_emulator
    if options.command:
        model, states = commanded_motion(
            policy, options.system, options.command, is_inside=is_inside
        )
    else:
        model, states = policy_motion(
            policy, options.system, options.seconds, options.seed or 0, is_inside=is_inside
        )
    return SourcedMotion(model, [states], "emulator" if is_inside else "physics")


def _driven(
    options: MotionOptions, drive_of: Callable[[Emulator, MotionOptions], Drive]
) -> SourcedMotion:
    """Return the motion of the emulator, or of emulator and physics in turns."""
    with phase("loading"):
        model = emulator_for(options.out, options.emulator)
    gain = []
    with phase("emulating"):
        drive = drive_of(model, options)
        if options.hybrid:
            # With them comes MuJoCo.
            from neuroanimator.learn.evaluation.hybrid_shares import motion_in_turns
            from neuroanimator.physics.loading import trust_files

            if options.system:
                trust_files(options.system)
            motion, worth = motion_in_turns(model, drive.start, drive.controls, options.threshold)
            states = motion.states
            scores = motion.scores
            gain = [("hybrid", worth)]
        else:
            states, scores = drive.trusted_motion(model)
    for remark in drive.remarks:
        print_line(f"neuroanimator: {remark}", to_stderr=True)
    rows = [("trust", summary_of(model, scores)), *gain]
    made_by = "hybrid" if options.hybrid else "emulator"
    return SourcedMotion(model, [states], made_by, scores if options.trust else None, rows)


def _along_paths(model: Emulator, options: MotionOptions) -> Drive:
    paths: dict[str, RecordedPath | str] = {}
    for text in options.path or ():
        name, equals, source = text.partition("=")
        if not equals and text.lower().endswith(".glb"):
            paths = paths_of_nodes(read_glb(Path(text)), text, movers_of(model)) | paths
            continue
        if not equals or not name or not source:
            raise ArgumentError(
                f"path: wanted MOVER=FILE such as torso=walk.csv, or a GLB file, got {quoted(text)}."
            )
        if name in paths:
            raise ArgumentError(f"path: {quoted(name)} has two paths. Give one.")
        paths[name] = source
    speed = 1.0 if options.path_speed is None else options.path_speed
    return path_drive(model, paths, speed=speed, seconds=options.seconds)


def _under_controls(model: Emulator, options: MotionOptions) -> Drive:
    assert options.controls is not None
    return controlled_drive(
        model, read_controls(options.controls, model), start_of(model, options.start)
    )


def _at_random(model: Emulator, options: MotionOptions) -> Drive:
    tied = tied_system(model.spec)
    start = start_of(model, options.start)
    if options.seconds is None and options.seed is None and start is None:
        return default_drive(model, tied)
    return random_drive(model, options.seconds, options.seed or 0, start, tied)


def start_of(model: Emulator, parts: list[str] | None) -> Float[np.ndarray, " S"] | None:
    """Return the state that the options `--start` describe; None if there are none."""
    if not parts:
        return None
    return named_start(model, read_starts(parts), tied_system(model.spec))


SOURCES: dict[str, Callable[[MotionOptions], SourcedMotion]] = {
    "school": _of_school,
    "policy": _of_policy,
    "path": partial(_driven, drive_of=_along_paths),
    "controls": partial(_driven, drive_of=_under_controls),
    "random": partial(_driven, drive_of=_at_random),
}
"""Sources of motion, by the option that asks for them; the last needs none."""

REFUSED_BESIDE = {
    "policy": (
        ("controls", "path", "start", "hybrid", "trust"),
        "a policy determines its own start and motion. Leave it out.",
    ),
    "path": (
        ("controls", "start", "seed"),
        "a motion along a path begins and moves as the path does. Leave it out, or --path.",
    ),
    "school": (
        ("controls", "path", "start", "trust", "hybrid"),
        "a school is steered by its policy. Leave it out, or --school.",
    ),
    "command": (
        ("seconds", "seed"),
        "commands already determine the motion. Leave one of them out.",
    ),
}
"""Options that are refused beside one, and why."""

APPLY_TO = (
    (("policy",), ("command", "in_emulator"), "applies to policy files only. Leave it out."),
    (
        ("hybrid", "policy"),
        ("threshold", "system"),
        "applies to --hybrid only. Give --hybrid, too.",
    ),
    (("path",), ("path_speed",), "applies to --path only. Give --path, too."),
)
"""Options that need one of others, and why."""
