"""The MJCF files of Gymnasium's own MuJoCo environments. Needs the extra `[gym]`."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from jaxtyping import Float

from neuroanimator.errors import ArgumentError

MUJOCO = Path(gymnasium.__file__).parent / "envs" / "mujoco"
"""Folder of Gymnasium's MuJoCo environments; their models lie in its `assets`."""

INFINITY = "float('inf')"
"""How these environments write infinity, which as a literal is a number too large."""

RESETS = 256
"""Number of resets of an environment, which show where its episodes begin."""


def mjcf_of(env_id: str) -> Path:
    """Return the MJCF file of Gymnasium's MuJoCo environment `env_id`, such as `Swimmer-v5`.

    Raises ArgumentError for any other id.
    """
    name = default_of(env_id, "xml_file")
    if name is None and env_id in gymnasium.registry:
        raise ArgumentError(
            f"{env_id} has no MuJoCo model. Write its physics as a function in a file: neuroanimator new my_step.py."
        )
    if name is None:
        valid = ", ".join(
            sorted(other for other in gymnasium.registry if default_of(other, "xml_file"))
        )
        raise ArgumentError(f"No MuJoCo environment called '{env_id}'. Environments: {valid}.")
    return MUJOCO / "assets" / name


def default_of(env_id: str, argument: str) -> Any:
    """Return the default of an argument of the class of Gymnasium's MuJoCo environment `env_id`; None if there is none."""
    spec = gymnasium.registry.get(env_id)
    if spec is None:
        return None
    module, _, _ = str(spec.entry_point).partition(":")
    source = MUJOCO / f"{module.removeprefix('gymnasium.envs.mujoco.')}.py"
    if not source.is_file():
        return None
    # Parsed, not imported: these modules need an imaging library that nothing else here needs.
    for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
        if isinstance(node, ast.arguments):
            # Defaults belong to the last arguments.
            with_defaults = zip(reversed(node.args), reversed(node.defaults), strict=False)
            for given, default in with_defaults:
                if given.arg == argument:
                    return ast.literal_eval(ast.unparse(default).replace(INFINITY, "1e999"))
    return None


def reset_states(env_id: str) -> Float[np.ndarray, "B S"] | None:
    """Return positions and velocities (qpos, qvel) after `RESETS` resets of Gymnasium's MuJoCo environment `env_id`.

    None if it cannot be made: some need an imaging library.
    """
    try:
        env: Any = gymnasium.make(env_id).unwrapped
    except (ImportError, gymnasium.error.Error):
        return None
    states = []
    for seed in range(RESETS):
        env.reset(seed=seed)
        states.append(np.concatenate([env.data.qpos, env.data.qvel]))
    env.close()
    return np.array(states)
