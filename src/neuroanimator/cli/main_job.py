"""The main job on real physics: generate → train → evaluate → swing up → replay → GLB, MP4, report."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from neuroanimator.animation.clip import make_clip
from neuroanimator.cli.generate import generate_with_bar
from neuroanimator.control.descent.options import DescentOptions
from neuroanimator.control.synthesis.attempt import SearchOptions
from neuroanimator.control.synthesis.summary import outcome_rows
from neuroanimator.control.synthesis.synthesise import Synthesis, synthesise_goal
from neuroanimator.emulator.emulator import Emulator, load_emulator
from neuroanimator.errors import ResourceError
from neuroanimator.export.csv_file import write_controls
from neuroanimator.export.gltf.scene import write_glb
from neuroanimator.files.atomic import canonical_json, write_whole
from neuroanimator.film.control_report import control_html
from neuroanimator.film.inline import film_html
from neuroanimator.film.video import write_video
from neuroanimator.learn.data.config import DatasetConfig
from neuroanimator.learn.data.store import Transitions, read_transitions
from neuroanimator.learn.evaluation.evaluate import Evaluation, evaluate
from neuroanimator.learn.evaluation.report import training_html, write_report
from neuroanimator.learn.refinement import Refinement
from neuroanimator.learn.training.config import TrainingConfig
from neuroanimator.learn.training.train import SO_FAR, Report, run_folder, train
from neuroanimator.physics import load_system
from neuroanimator.systems.random_controls import sample_controls
from neuroanimator.terminal import print_rows, progress_bar

SYSTEM = "pendulum"
"""The system to learn: three links and three motors."""

SUBSTEPS = 50
"""Number of physics steps the emulator leaps at a time."""

TRANSITIONS = 100_000
"""Number of super steps the emulator learns from."""

UPDATES = 12_000
"""Number of updates of the emulator's weights."""

SWEEPS = 16
"""Maximum number of backward sweeps of the first descent."""

CORRECTIONS = 2
"""Maximum number of corrections that follow, of two sweeps each: at most twenty iterations in all."""

LOOK_SECONDS = 2.0
"""Duration of the films that show what the emulator has learnt [s]."""

FIRST_FILM = "first-motion.mp4"
LEARNT_FILM = "learnt-motion.mp4"

LOOK_SIZE = (480, 270)
"""Width and height of these films [pixels]: small, as training waits for them."""

HOLD_SECONDS = 0.5
"""Time for which the film holds the last state, to show the pendulum standing [s]."""


def run_demo(out: Path) -> dict[str, Any]:
    """Do the main job in `out` and print the measurements; return the summary, which is also written there."""
    began = time.monotonic()
    data, seconds_data = _timed("1/5 simulate", lambda: _generate(out / "data"))
    emulator, seconds_training = _timed(
        "2/5 train", lambda: _train(data, out / f"{SYSTEM}.emulator.safetensors")
    )
    evaluation, _ = _timed("3/5 evaluate", lambda: evaluate(emulator, data=data))
    synthesis, _ = _timed("4/5 swing up", lambda: _swing_up(emulator, data))
    files, _ = _timed("5/5 draw and write", lambda: _write(out, evaluation, synthesis))
    saved = evaluation.speed.physics_seconds * SUBSTEPS - evaluation.speed.emulator_seconds
    break_even = (seconds_data + seconds_training) / saved * emulator.dt
    summary = {
        "one_step_error": evaluation.one_step_error,
        "rollout_error_1s": evaluation.rollout_error_at(1.0),
        "nominal_speedup": evaluation.speed.nominal,
        "equal_error_speedup": evaluation.speed.equal_error,
        "iterations": synthesis.spent.iterations,
        "synthesis_seconds": synthesis.spent.seconds,
        "cost_emulator": synthesis.outcome.cost_emulator,
        "cost_physics": synthesis.outcome.cost_physics,
        "upright_on_physics": synthesis.is_reached,
        "seconds_total": time.monotonic() - began,
        "files": [str(path) for path in files] + [str(out / "summary.json")],
    }
    write_whole(out / "summary.json", (canonical_json(summary) + "\n").encode())
    _print(summary, evaluation, synthesis, break_even)
    return summary


def _timed(title: str, work: Any) -> tuple[Any, float]:
    print(f"{title} ...", file=sys.stderr, flush=True)
    began = time.monotonic()
    return work(), time.monotonic() - began


def _generate(folder: Path) -> Transitions:
    config = DatasetConfig(system=SYSTEM, substeps=SUBSTEPS, count=TRANSITIONS, seed=0)
    generate_with_bar(config, folder)
    return read_transitions(folder)


def _train(data: Transitions, path: Path) -> Emulator:
    config = TrainingConfig(updates=UPDATES)
    is_first = True
    with progress_bar("updates", config.whole_updates) as bar:

        def on_report(report: Report) -> None:
            nonlocal is_first
            bar.advance_to(report.update, f"error {report.error:.4f}")
            so_far = run_folder(path) / SO_FAR
            if is_first and so_far.exists():
                _film(load_emulator(so_far), path.with_name(FIRST_FILM), report.update)
            is_first = False

        emulator = train(data, config, path, on_report=on_report)
    _film(emulator, path.with_name(LEARNT_FILM), config.whole_updates)
    return emulator


def _film(emulator: Emulator, path: Path, updates: int) -> None:
    """Film the motion of an emulator after `updates`, translucent, over MuJoCo's under the same random controls."""
    system = load_system(SYSTEM)
    steps = round(LOOK_SECONDS / emulator.dt)
    controls = sample_controls(np.random.default_rng(0), steps, emulator.dt, system.bounds)
    true = system.simulate(system.rest[None], controls[None], emulator.dt).states[0]
    emulated = make_clip(emulator, emulator.rollout(system.rest, controls))
    try:
        write_video(make_clip(emulator, true), path, ghost=emulated, size=LOOK_SIZE)
    except ResourceError:
        return  # said once, for the film of the swing-up
    print(
        f"    {path}: after {updates:,} updates, translucent over MuJoCo's motion", file=sys.stderr
    )


def _swing_up(emulator: Emulator, data: Transitions) -> Synthesis:
    return synthesise_goal(
        emulator,
        load_system(SYSTEM),
        "upright",
        options=SearchOptions(
            DescentOptions(iterations=SWEEPS),
            corrections=CORRECTIONS,
            refine=Refinement(data=data, on_refine=_say_gap),
            measures_trust=True,
        ),
    )


def _say_gap(gap: float) -> None:
    print(f"    gap {gap:.2f}: training on the physics around the motion", file=sys.stderr)


def _write(out: Path, evaluation: Evaluation, synthesis: Synthesis) -> list[Path]:
    emulator = synthesis.emulator
    states = synthesis.outcome.physics_states
    at_rest = states[-1:] * [1, 1, 1, 0, 0, 0]  # the angles stay, their rates vanish
    hold = np.repeat(at_rest, round(HOLD_SECONDS / emulator.dt), axis=0)
    clip = make_clip(emulator, np.concatenate([states, hold]))
    scene = out / "swing-up.glb"
    table = out / "swing-up.csv"
    report = out / "report.html"
    video = out / "swing-up.mp4"
    write_glb(clip, scene)
    write_controls(table, synthesis.controls, emulator)
    trained = out / f"{SYSTEM}.emulator.safetensors"
    files = [scene, table, report, trained]
    files += [out / name for name in (FIRST_FILM, LEARNT_FILM) if (out / name).exists()]
    film = Markup("")
    try:
        write_video(clip, video)
        files.append(video)
        film = film_html(video, "The swing-up on the true physics.")
    except ResourceError as error:
        print(f"neuroanimator: {error}", file=sys.stderr)
    sections = [
        ("Swing-up", control_html(synthesis, film)),
        ("How it was trained", training_html(trained)),
    ]
    write_report([evaluation], report, extra=sections)
    return files


def _print(
    summary: dict[str, Any], evaluation: Evaluation, synthesis: Synthesis, break_even: float
) -> None:
    print_rows(
        [
            ("system", f"{SYSTEM}, n = {SUBSTEPS}: one super step is {evaluation.dt * 1e3:g} ms"),
            (
                "one-step error",
                f"{summary['one_step_error']:.4f} of the change's standard deviation",
            ),
            (
                "rollout error after 1 s",
                f"{summary['rollout_error_1s']:.4f} of the state's standard deviation",
            ),
            ("nominal speed-up", f"{summary['nominal_speedup']:.0f} (MuJoCo Euler, 1 ms)"),
            ("equal-error speed-up", evaluation.equal_error_text),
            ("verdict", evaluation.verdict),
            ("diverged", f"{evaluation.diverged} of {evaluation.diverged_starts} random starts"),
            (
                "break-even",
                f"after {break_even / 3600:.1f} simulated hours (data and training counted)",
            ),
            *outcome_rows(synthesis),
            ("total seconds", f"{summary['seconds_total']:.0f}"),
            *(("file", path) for path in summary["files"]),
        ]
    )
