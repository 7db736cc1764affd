"""`control --closed-loop`: pursue a goal, planning again at every super step."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float

from neuroanimator.animation.clip import make_clip
from neuroanimator.animation.gauges import drawable
from neuroanimator.cli.control_output import start_in_words, time_rows
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.export.csv_file import write_controls
from neuroanimator.export.gltf.scene import write_glb
from neuroanimator.learn.planning.pursue import pursue_goal, pursuit_rows, pursuit_steps
from neuroanimator.systems.system import System
from neuroanimator.terminal import phase, print_rows, progress_bar


def run_closed_loop(
    emulator: Emulator,
    system: System,
    goal: str,
    start: Float[np.ndarray, " S"],
    *,
    seconds: float | None,
    horizon: float | None,
    effort_weight: float,
    out: Path,
    glb: Path | None,
) -> None:
    """Pursue `goal` from `start` (S,), write the controls and the motion, and print the result."""
    with progress_bar("planning", pursuit_steps(emulator, system, goal, seconds)) as bar:
        pursuit = pursue_goal(
            emulator,
            system,
            goal,
            seconds,
            start=start,
            horizon=horizon,
            effort_weight=effort_weight,
            on_step=bar.advance_to,
        )
    motion = pursuit.motion
    write_controls(out, motion.controls, emulator)
    if glb:
        with phase("drawing"):
            source = "physics" if pursuit.is_on_physics else "emulator"
            clip = make_clip(emulator, motion.states, source=source)
            write_glb(drawable(clip, emulator), glb)
    files = [("file", path) for path in (out, glb) if path]
    words = start_in_words(system, start)
    print_rows([("start", words), *pursuit_rows(pursuit), *time_rows(), *files])
