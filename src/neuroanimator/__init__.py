"""NeuroAnimator: learn a physics model once, then animate and control it at a fraction of the cost."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from neuroanimator.lazy import lazy_names

if TYPE_CHECKING:
    from neuroanimator.animation.clip import Clip, make_clip
    from neuroanimator.animation.gauges import as_gauges
    from neuroanimator.backend import set_backend
    from neuroanimator.control.descent.descend import descend
    from neuroanimator.control.descent.options import DescentOptions
    from neuroanimator.control.objective.costs import (
        effort,
        follow_path,
        keep_heading,
        keep_speed,
        keep_velocity,
        reach_heading,
        reach_height,
        reach_point,
        reach_position,
        reach_positions,
        smoothness,
        stand_up,
        stay_upright,
        stay_within,
        travel,
    )
    from neuroanimator.control.objective.goals import goal, is_reached, reach_state
    from neuroanimator.control.objective.objective import CostTerm, Objective, StateTerm
    from neuroanimator.control.objective.obstacles import avoid
    from neuroanimator.control.objective.trusted import stay_trusted
    from neuroanimator.control.policies.pilot import Pilot
    from neuroanimator.control.policies.policy import Policy
    from neuroanimator.control.policies.policy_file import load_policy
    from neuroanimator.control.synthesis.replay import replay
    from neuroanimator.control.synthesis.synthesise import Synthesis, synthesise
    from neuroanimator.data.config import DatasetConfig
    from neuroanimator.data.diverged_runs import read_diverged
    from neuroanimator.data.generate import generate
    from neuroanimator.data.store import read_transitions
    from neuroanimator.data.stored import open_transitions
    from neuroanimator.emulator.emulator import Emulator, load_emulator
    from neuroanimator.errors import NeuroAnimatorError
    from neuroanimator.evaluation.drift import measure_drift
    from neuroanimator.evaluation.evaluate import EvaluationBudget, evaluate
    from neuroanimator.evaluation.report import write_report
    from neuroanimator.evaluation.weakness.config import ImprovementConfig
    from neuroanimator.evaluation.weakness.coverage import coverage
    from neuroanimator.evaluation.weakness.fine_tune import fine_tune
    from neuroanimator.evaluation.weakness.improve import improve
    from neuroanimator.evaluation.weakness.inspection import inspect
    from neuroanimator.executor.local import LocalExecutor
    from neuroanimator.executor.ray_cluster import RayExecutor
    from neuroanimator.export.comparison import write_comparison
    from neuroanimator.export.control_report import write_control_report
    from neuroanimator.export.csv_file import read_clip, write_clip
    from neuroanimator.export.film.inline import show
    from neuroanimator.export.film.video import write_video
    from neuroanimator.export.gltf.scene import write_glb
    from neuroanimator.export.programs.c_file import write_c_header
    from neuroanimator.export.programs.numpy_file import write_numpy
    from neuroanimator.export.programs.onnx_file import write_onnx
    from neuroanimator.export.programs.wasm_file import write_wasm
    from neuroanimator.export.usd.scene import write_usd
    from neuroanimator.export.worst_cases import write_worst
    from neuroanimator.hybrid import HybridMotion, hybrid_rollout
    from neuroanimator.state.layout import Bounds
    from neuroanimator.state.pose import read_heights, read_pose
    from neuroanimator.systems import load_system
    from neuroanimator.systems.loading import trust_files
    from neuroanimator.training.config import TrainingConfig
    from neuroanimator.training.error_fitting import UnseenRuns, fit_error_bounds
    from neuroanimator.training.train import train
    from neuroanimator.training.trust_fitting import fit_trust

__version__: str
"""Version of the installed package."""

_HOMES = {
    "load_system": "systems",
    "trust_files": "systems.loading",
    "DatasetConfig": "data.config",
    "generate": "data.generate",
    "read_transitions": "data.store",
    "open_transitions": "data.stored",
    "read_diverged": "data.diverged_runs",
    "coverage": "evaluation.weakness.coverage",
    "TrainingConfig": "training.config",
    "train": "training.train",
    "fit_trust": "training.trust_fitting",
    "fit_error_bounds": "training.error_fitting",
    "UnseenRuns": "training.error_fitting",
    "ImprovementConfig": "evaluation.weakness.config",
    "improve": "evaluation.weakness.improve",
    "fine_tune": "evaluation.weakness.fine_tune",
    "Emulator": "emulator.emulator",
    "load_emulator": "emulator.emulator",
    "set_backend": "backend",
    "hybrid_rollout": "hybrid",
    "HybridMotion": "hybrid",
    "LocalExecutor": "executor.local",
    "RayExecutor": "executor.ray_cluster",
    "EvaluationBudget": "evaluation.evaluate",
    "measure_drift": "evaluation.drift",
    "evaluate": "evaluation.evaluate",
    "inspect": "evaluation.weakness.inspection",
    "write_report": "evaluation.report",
    "Objective": "control.objective.objective",
    "CostTerm": "control.objective.objective",
    "StateTerm": "control.objective.objective",
    "goal": "control.objective.goals",
    "reach_state": "control.objective.goals",
    "is_reached": "control.objective.goals",
    "reach_position": "control.objective.costs",
    "reach_positions": "control.objective.costs",
    "reach_height": "control.objective.costs",
    "reach_point": "control.objective.costs",
    "reach_heading": "control.objective.costs",
    "follow_path": "control.objective.costs",
    "travel": "control.objective.costs",
    "keep_velocity": "control.objective.costs",
    "keep_speed": "control.objective.costs",
    "keep_heading": "control.objective.costs",
    "stand_up": "control.objective.costs",
    "stay_trusted": "control.objective.trusted",
    "stay_upright": "control.objective.costs",
    "stay_within": "control.objective.costs",
    "effort": "control.objective.costs",
    "smoothness": "control.objective.costs",
    "avoid": "control.objective.obstacles",
    "read_pose": "state.pose",
    "read_heights": "state.pose",
    "Bounds": "state.layout",
    "DescentOptions": "control.descent.options",
    "descend": "control.descent.descend",
    "replay": "control.synthesis.replay",
    "Synthesis": "control.synthesis.synthesise",
    "synthesise": "control.synthesis.synthesise",
    "Policy": "control.policies.policy",
    "load_policy": "control.policies.policy_file",
    "Pilot": "control.policies.pilot",
    "Clip": "animation.clip",
    "make_clip": "animation.clip",
    "as_gauges": "animation.gauges",
    "read_clip": "export.csv_file",
    "write_clip": "export.csv_file",
    "write_glb": "export.gltf.scene",
    "write_usd": "export.usd.scene",
    "write_comparison": "export.comparison",
    "write_control_report": "export.control_report",
    "show": "export.film.inline",
    "write_video": "export.film.video",
    "write_worst": "export.worst_cases",
    "write_c_header": "export.programs.c_file",
    "write_numpy": "export.programs.numpy_file",
    "write_onnx": "export.programs.onnx_file",
    "write_wasm": "export.programs.wasm_file",
    "NeuroAnimatorError": "errors",
}

__all__ = [  # noqa: RUF022 (by what they are for)
    # Learn.
    "load_system",
    "trust_files",
    "DatasetConfig",
    "generate",
    "read_transitions",
    "open_transitions",
    "read_diverged",
    "coverage",
    "TrainingConfig",
    "train",
    "fit_trust",
    "fit_error_bounds",
    "UnseenRuns",
    "ImprovementConfig",
    "improve",
    "fine_tune",
    "Emulator",
    "load_emulator",
    "set_backend",
    "hybrid_rollout",
    "HybridMotion",
    "LocalExecutor",
    "RayExecutor",
    "EvaluationBudget",
    "evaluate",
    "inspect",
    "measure_drift",
    "write_report",
    # Control: what a motion should achieve.
    "Objective",
    "CostTerm",
    "StateTerm",
    "goal",
    "reach_state",
    "is_reached",
    "reach_position",
    "reach_positions",
    "reach_height",
    "reach_point",
    "reach_heading",
    "follow_path",
    "travel",
    "keep_velocity",
    "keep_speed",
    "keep_heading",
    "stand_up",
    "stay_upright",
    "stay_within",
    "stay_trusted",
    "effort",
    "smoothness",
    "avoid",
    "read_pose",
    "read_heights",
    "Bounds",
    # Control: find it.
    "DescentOptions",
    "descend",
    "replay",
    "Synthesis",
    "synthesise",
    "Policy",
    "load_policy",
    "Pilot",
    # Show.
    "Clip",
    "make_clip",
    "as_gauges",
    "read_clip",
    "write_clip",
    "write_glb",
    "write_usd",
    "write_comparison",
    "write_control_report",
    "show",
    "write_video",
    "write_worst",
    # Use elsewhere.
    "write_c_header",
    "write_numpy",
    "write_onnx",
    "write_wasm",
    # Errors.
    "NeuroAnimatorError",
]

_load, _names = lazy_names(__name__, _HOMES)


def __dir__() -> list[str]:
    return sorted([*_names(), "__version__"])


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return _version()
    return _load(name)


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("neuroanimator")
    except PackageNotFoundError:  # run from a source folder that is not installed
        return "unknown"
