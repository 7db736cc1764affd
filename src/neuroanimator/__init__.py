"""NeuroAnimator: learn a physics model once, then animate and control it at a fraction of the cost."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from neuroanimator.animation.clip import Clip, make_clip
    from neuroanimator.control.descent.descend import descend
    from neuroanimator.control.objective.costs import (
        effort,
        follow_path,
        keep_heading,
        keep_speed,
        keep_velocity,
        reach_heading,
        reach_height,
        reach_position,
        reach_positions,
        smoothness,
        stand_up,
        stay_upright,
        stay_within,
        travel,
    )
    from neuroanimator.control.objective.goals import (
        is_reached,
        is_upright,
        reach_goal,
        reach_state,
        stand_upright,
    )
    from neuroanimator.control.objective.objective import Objective, Term
    from neuroanimator.control.objective.obstacles import avoid
    from neuroanimator.control.policies.pilot import Pilot
    from neuroanimator.control.policies.policy import Policy
    from neuroanimator.control.policies.policy_file import load_policy
    from neuroanimator.control.synthesis.replay import replay
    from neuroanimator.control.synthesis.synthesise import Synthesis, synthesise
    from neuroanimator.data.config import DatasetConfig
    from neuroanimator.data.diverged_runs import read_diverged
    from neuroanimator.data.generate import generate
    from neuroanimator.data.store import read_transitions
    from neuroanimator.emulator.emulator import Emulator
    from neuroanimator.errors import NeuroAnimatorError
    from neuroanimator.evaluation.evaluate import Effort, evaluate
    from neuroanimator.evaluation.report import write_report
    from neuroanimator.export.comparison import write_comparison
    from neuroanimator.export.csv_file import read_clip, write_clip
    from neuroanimator.export.film.video import write_video
    from neuroanimator.export.gltf.scene import write_glb
    from neuroanimator.state.pose import read_pose
    from neuroanimator.systems import load_system
    from neuroanimator.systems.loading import trust_files
    from neuroanimator.training.config import TrainingConfig
    from neuroanimator.training.train import train
    from neuroanimator.zoo import find_emulator

__version__: str
"""Of the installed package."""

# Loaded on first use, so that `neuroanimator --help` does not wait for JAX and MuJoCo.
_HOMES = {
    "Clip": "animation.clip",
    "Effort": "evaluation.evaluate",
    "Emulator": "emulator.emulator",
    "NeuroAnimatorError": "errors",
    "Objective": "control.objective.objective",
    "Pilot": "control.policies.pilot",
    "Policy": "control.policies.policy",
    "Synthesis": "control.synthesis.synthesise",
    "Term": "control.objective.objective",
    "avoid": "control.objective.obstacles",
    "DatasetConfig": "data.config",
    "descend": "control.descent.descend",
    "effort": "control.objective.costs",
    "evaluate": "evaluation.evaluate",
    "find_emulator": "zoo",
    "follow_path": "control.objective.costs",
    "generate": "data.generate",
    "is_reached": "control.objective.goals",
    "is_upright": "control.objective.goals",
    "keep_heading": "control.objective.costs",
    "keep_speed": "control.objective.costs",
    "keep_velocity": "control.objective.costs",
    "reach_positions": "control.objective.costs",
    "load_policy": "control.policies.policy_file",
    "load_system": "systems",
    "make_clip": "animation.clip",
    "reach_goal": "control.objective.goals",
    "reach_heading": "control.objective.costs",
    "reach_height": "control.objective.costs",
    "reach_position": "control.objective.costs",
    "reach_state": "control.objective.goals",
    "read_clip": "export.csv_file",
    "read_diverged": "data.diverged_runs",
    "read_pose": "state.pose",
    "read_transitions": "data.store",
    "replay": "control.synthesis.replay",
    "smoothness": "control.objective.costs",
    "stand_up": "control.objective.costs",
    "stand_upright": "control.objective.goals",
    "stay_upright": "control.objective.costs",
    "stay_within": "control.objective.costs",
    "synthesise": "control.synthesis.synthesise",
    "train": "training.train",
    "TrainingConfig": "training.config",
    "travel": "control.objective.costs",
    "trust_files": "systems.loading",
    "write_clip": "export.csv_file",
    "write_glb": "export.gltf.scene",
    "write_comparison": "export.comparison",
    "write_report": "evaluation.report",
    "write_video": "export.film.video",
}

__all__ = [  # noqa: RUF022 (types first, then the pipeline's order)
    "Clip", "Effort", "Emulator", "NeuroAnimatorError", "Objective", "Pilot", "Policy", "Synthesis", "Term",
    "load_system", "trust_files", "DatasetConfig", "generate", "read_transitions", "read_diverged",
    "TrainingConfig", "train", "find_emulator", "evaluate", "write_report",
    "effort", "smoothness", "reach_state", "reach_goal", "reach_position", "reach_height", "reach_heading", "reach_positions",
    "follow_path", "travel", "keep_velocity", "keep_speed", "keep_heading", "stand_up", "stand_upright", "stay_upright",
    "stay_within", "avoid", "descend", "replay", "synthesise", "read_pose", "is_upright", "is_reached",
    "load_policy", "make_clip", "read_clip", "write_clip", "write_glb", "write_comparison", "write_video",
]  # fmt: skip


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return _version()
    if name not in _HOMES:
        raise AttributeError(f"neuroanimator has no '{name}'")
    return getattr(import_module(f"neuroanimator.{_HOMES[name]}"), name)


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("neuroanimator")
    except PackageNotFoundError:  # run from a source folder that is not installed
        return "unknown"
