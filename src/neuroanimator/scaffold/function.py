"""A first definition for somebody's step function: what it declares, and what a few trial runs show."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from neuroanimator.definitions.function import PythonDefinition
from neuroanimator.errors import BadFileError
from neuroanimator.scaffold.defaults import GOOD_ENOUGH, WHOLE_TURN, proposed_substeps
from neuroanimator.systems.functions.function_system import PythonSystem
from neuroanimator.systems.functions.step_file import call_step, run_file
from neuroanimator.systems.system import Scheme
from neuroanimator.systems.trusted_files import digest_of
from neuroanimator.tables import check_table

FINE_PARTS = 10
TEACHER_PARTS = (1, 2, 5, 10)
"""Parts of the user's step tried for the teacher."""

TRIAL_RUNS, TRIAL_STEPS = 8, 25

AT_ITS_OWN_STEP = (
    "the function at its own step is the truth. Where it integrates an equation and is the better the smaller dt is, "
    "say ODE = True in {file}"
)

EXAMPLES = {
    "STEP": "STEP = 0.01",
    "STATE": 'STATE = {"angle": "rad", "speed": "rad/s"}',
    "CONTROL": 'CONTROL = {"torque": ("N·m", -2.0, 2.0)}',
    "ANGLES": 'ANGLES = ["angle"]',
    "RATES": 'RATES = {"angle": "speed"}',
    "REST": 'REST = {"angle": 0.0}',
    "SPREAD": 'SPREAD = {"angle": 3.14, "speed": 4.0}',
    "ODE": "ODE = True",
}
"""How each declaration is written."""


def propose_function(path: Path) -> tuple[PythonDefinition, dict[str, str]]:
    """Return a definition of the step file at `path`, which the user allowed, and notes on its keys; this runs it."""
    digest = digest_of(path)
    module = run_file(digest, path.name)
    files = {"name": path.name, "sha256": digest}
    values, notes = _declared(path, module), {}
    if not getattr(module, "SPREAD", None):
        for part, width in zip(
            values["state"], _reached(PythonSystem(_check(values, path), files)), strict=True
        ):
            part["spread"] = width
        notes["state.spread"] = "as far as trial runs went; SPREAD in the file says it better"
    system = PythonSystem(_check(values, path), files)
    _check_batches(system)
    notes["physics.truth_step"] = AT_ITS_OWN_STEP.format(file=path.name)
    if _is_ode(path, module):
        parts, error = _teacher(system)
        step = values["physics"]["step"]
        values["physics"] |= {"truth_step": step / parts, "fine_step": step / FINE_PARTS}
        notes["physics.truth_step"] = (
            f"{path.name} says ODE; teaches with an error of {error:.2g} of a step's change"
        )
    return _check(values, path), notes


def _check(values: dict[str, Any], path: Path) -> PythonDefinition:
    return check_table(values, path.name, PythonDefinition)


def _declared(path: Path, module: ModuleType) -> dict[str, Any]:
    """Return what the file itself says."""
    step = _declaration(path, module, "STEP", (int, float))
    state, control = (_declaration(path, module, name, dict) for name in ("STATE", "CONTROL"))
    named = {
        name: _declaration(path, module, name, dict, {}) for name in ("RATES", "REST", "SPREAD")
    }
    angles = _declaration(path, module, "ANGLES", (list, tuple), ())
    for name, parts in {**named, "ANGLES": angles}.items():
        for part in parts:
            if part not in state:
                raise BadFileError(
                    f"{path.name}: {name}: no part '{part}' in STATE. Parts: {', '.join(state)}."
                )
    return {
        "name": path.stem.lower().replace(" ", "-"),
        "kind": "python",
        "file": path.name,
        "batched": bool(getattr(module, "BATCHED", False)),
        "substeps": proposed_substeps(step) if step > 0 else 1,
        "physics": {"step": step, "truth_step": step, "fine_step": step},
        "state": [
            _state_part(path, name, value, name in angles, named) for name, value in state.items()
        ],
        "control": [_control_part(path, name, value) for name, value in control.items()],
        "sampling": {"rest_share": 0.3, "rest_spread": 0.15},
    }


def _is_ode(path: Path, module: ModuleType) -> bool:
    """Return whether the file says that its function integrates an equation, the better the smaller dt is."""
    value = getattr(module, "ODE", False)
    if not isinstance(value, bool):
        raise BadFileError(
            f"{path.name}: ODE: wanted a line like `{EXAMPLES['ODE']}`, came {repr(value)[:60]}."
        )
    return value


def _declaration(path: Path, module: ModuleType, name: str, kind: Any, default: Any = None) -> Any:
    value = getattr(module, name, default)
    if isinstance(value, bool) or not isinstance(value, kind) or (default is None and not value):
        came = "nothing" if value is None else repr(value)[:60]
        raise BadFileError(
            f"{path.name}: {name}: wanted a line like `{EXAMPLES[name]}`, came {came}."
        )
    return value


def _state_part(
    path: Path, name: str, value: Any, is_angle: bool, named: dict[str, Any]
) -> dict[str, Any]:
    unit, size = (value, 1) if isinstance(value, str) else _unpacked(path, "STATE", value, 2)
    if type(size) is not int:
        raise BadFileError(
            f"{path.name}: STATE: {name}: wanted a unit, or (unit, size), came {value!r}."
        )
    spread = named["SPREAD"].get(name, WHOLE_TURN if is_angle else 0.0)
    return {
        "name": name,
        "unit": unit,
        "size": size,
        "feature": "sine" if is_angle else "plain",
        "rate": named["RATES"].get(name, ""),
        "rest": _several(named["REST"].get(name, 0.0), size),
        "spread": _several(spread, size),
    }


def _control_part(path: Path, name: str, value: Any) -> dict[str, Any]:
    unit, low, high = _unpacked(path, "CONTROL", value, 3)
    return {"name": name, "unit": unit, "low": _several(low, 1), "high": _several(high, 1)}


def _unpacked(path: Path, name: str, value: Any, count: int) -> Any:
    if not isinstance(value, (tuple, list)) or len(value) != count:
        raise BadFileError(
            f"{path.name}: {name}: wanted a line like `{EXAMPLES[name]}`, came {value!r}."
        )
    return value


def _several(value: Any, size: int) -> list[Any]:
    """Return a list: the numbers given, or one number `size` times."""
    return list(value) if isinstance(value, (list, tuple, np.ndarray)) else [value] * size


def _trial(system: PythonSystem) -> tuple[np.ndarray, np.ndarray]:
    """Return (states (N, S), controls (N, C)) of trial runs under random controls."""
    rng = np.random.default_rng(0)
    starts = system.sample_starts(rng, TRIAL_RUNS)
    shape = (TRIAL_RUNS, TRIAL_STEPS, system.control.size)
    controls = system.bounds.middle + rng.uniform(-1, 1, shape) * system.bounds.half
    dt = proposed_substeps(system.physics_dt) * system.physics_dt
    runs = system.simulate(starts, controls, dt, scheme=system.scheme)
    if (~runs.has_diverged).sum() < TRIAL_RUNS / 2:
        raise BadFileError(
            f"{system.file}: {runs.has_diverged.sum()} of {TRIAL_RUNS} trial runs under random controls diverged. "
            "Use a smaller STEP, a smaller SPREAD or weaker CONTROL."
        )
    whole = ~runs.has_diverged
    return runs.states[whole, :-1].reshape(-1, system.state.size), controls[whole].reshape(
        -1, system.control.size
    )


def _reached(system: PythonSystem) -> list[list[float]]:
    """Return per part how far trial runs went from rest: twice the rms, two digits."""
    states, _ = _trial(system)
    far = 2 * np.sqrt(np.mean((states - system.rest) ** 2, axis=0))
    widths = np.where(system.spread > 0, system.spread, far)
    parts = [widths[system.state.index(part.name)] for part in system.state.slices]
    return [[float(f"{width:.2g}") for width in part] for part in parts]


def _check_batches(system: PythonSystem) -> None:
    """Refuse a function that says it takes batches and answers differently to them."""
    if not system.batched:
        return
    states, controls = _trial(system)
    whole = call_step(system.function, system.file, states.T, controls.T, system.physics_dt).T
    for state, control, found in zip(states, controls, whole, strict=True):
        alone = call_step(system.function, system.file, state, control, system.physics_dt)
        if not np.allclose(alone, found, rtol=1e-9, atol=1e-12):
            raise BadFileError(
                f"{system.file}: BATCHED: step answers (S, B) arrays otherwise than (S,). Leave it out."
            )


def _teacher(system: PythonSystem) -> tuple[int, float]:
    """Return (parts of the step that teach well enough, their error); refuse a function that ignores dt."""
    states, controls = _trial(system)
    step = system.physics_dt

    def after(parts: int, duration: float = step) -> np.ndarray:
        return system.simulate(
            states, controls[:, None], duration, scheme=Scheme("function", duration / parts)
        ).states[:, 1]

    if np.array_equal(after(1), after(1, step / 2)):
        raise BadFileError(
            f"{system.file}: ODE: step does the same for every dt. Leave ODE out, or use dt in step."
        )
    exact = after(FINE_PARTS)
    unit = np.maximum((exact - states).std(axis=0), 1e-9)
    for parts in TEACHER_PARTS:
        error = float(np.sqrt(np.mean(((after(parts) - exact) / unit) ** 2)))
        if error <= GOOD_ENOUGH:
            return parts, error
    return FINE_PARTS, 0.0
