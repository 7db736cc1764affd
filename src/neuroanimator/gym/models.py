"""The MJCF files of Gymnasium's own MuJoCo environments. Needs the extra `[gym]`."""

from __future__ import annotations

import ast
from pathlib import Path

import gymnasium

from neuroanimator.errors import ArgumentError

MUJOCO = Path(gymnasium.__file__).parent / "envs" / "mujoco"


def mjcf_of(env_id: str) -> Path:
    """Return the MJCF file of Gymnasium's MuJoCo environment `env_id`, such as `Swimmer-v5`.

    Raises ArgumentError for an id that is none of them.
    """
    name = _model_name(env_id)
    if name is None:
        valid = ", ".join(sorted(other for other in gymnasium.registry if _model_name(other)))
        raise ArgumentError(f"No MuJoCo environment called '{env_id}'. Environments: {valid}.")
    return MUJOCO / "assets" / name


def _model_name(env_id: str) -> str | None:
    """Return the default of the argument `xml_file` of the environment's class; None if there is none."""
    spec = gymnasium.registry.get(env_id)
    module = str(spec.entry_point).partition(":")[0] if spec else ""
    source = MUJOCO / f"{module.removeprefix('gymnasium.envs.mujoco.')}.py"
    # Read, not imported: these modules need an imaging library that nothing else here does.
    tree = ast.parse(source.read_text(encoding="utf-8") if source.is_file() else "")
    for signature in (node for node in ast.walk(tree) if isinstance(node, ast.arguments)):
        for argument, default in zip(
            reversed(signature.args), reversed(signature.defaults), strict=False
        ):
            if argument.arg == "xml_file":
                return ast.literal_eval(default)
    return None
