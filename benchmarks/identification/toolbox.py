"""MuJoCo's own system identification, given the same recordings, bounds and bodies.

It takes differences of `mujoco.rollout`, all of an iteration in one call on all threads. It is given the recording as a
whole or in the windows that `na.identify` cuts it into, with starts as they were measured or unknown as well.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import mujoco
import numpy as np
from jaxtyping import Float
from mujoco import sysid

from benchmarks.harness import Clocks
from benchmarks.identification.recordings import NOISE, Recording
from neuroanimator.codegen.cores import core_count
from neuroanimator.errors import ArgumentError
from neuroanimator.physics.rigid.model_system import ModelSystem
from neuroanimator.systems.system import Scheme

OPTIMISERS: dict[str, tuple[str, dict[str, Any]]] = {
    "mujoco": ("mujoco", {}),
    "mujoco scaled": ("mujoco", {"x_scale": "jac"}),
    "scipy": ("scipy", {"x_scale": "jac"}),
    "scipy parallel": ("scipy_parallel_fd", {"x_scale": "jac"}),
}
"""Its optimisers and settings that are tried."""

MAX_ITERATIONS = 100

START_BOUND = 5.0
"""Unknown starts lie within so many standard deviations of the noise."""

Unknowns = Float[np.ndarray, " U"]


class Way(NamedTuple):
    """How the toolbox is given a recording."""

    name: str
    window: int | None
    """Number of super steps in a window; None for the whole recording."""
    has_unknown_starts: bool


WAYS = (
    Way("whole", None, False),
    Way("whole, start unknown", None, True),
    Way("windows", 16, False),
    Way("windows, starts unknown", 16, True),
)


class OutOfTimeError(Exception):
    """The toolbox took longer than it was given."""


@dataclass(frozen=True)
class Outcome:
    """What the toolbox found."""

    values: Float[np.ndarray, " P"]
    seconds: float
    cpu_seconds: float
    iterations: int
    trials: tuple[tuple[float, Float[np.ndarray, " P"]], ...]
    """The time [s] and the parameters of each point it tried."""
    end: str
    """How it ended."""


def require_toolbox() -> None:
    """Raise ArgumentError where the toolbox lacks packages: it then has no names at all."""
    if not hasattr(sysid, "optimize"):
        raise ArgumentError(
            "mujoco.sysid: its packages are missing. Run: pip install 'mujoco[sysid]'."
        )


class Residuals(Protocol):
    """What the toolbox minimises."""

    size: int
    """Number of parameters of the body."""

    def parameters(self) -> sysid.ParameterDict:
        """Return what it looks for, those of the body as "body", with initial values and bounds."""
        ...

    def residuals(
        self, unknowns: Float[np.ndarray, " ..."], parameters: sysid.ParameterDict, /
    ) -> Any:
        """Return the residuals of one point (U,) or of several (U, N): (R,) or (R, N)."""
        ...


class Problem:
    """A recording as residuals of the toolbox."""

    def __init__(self, recording: Recording, system: ModelSystem, scheme: Scheme, way: Way):
        self.system = system
        self.size = len(system.parameters)
        self.way = way
        self.model = system.model_with(scheme)
        self.substeps = scheme.steps(recording.dt)
        self.scale = recording.measured.std(axis=0)
        steps = way.window or len(recording.controls)
        count = len(recording.controls) // steps
        self.starts = recording.measured[: count * steps : steps]
        self.windows = [self._window(recording, steps * i, steps) for i in range(count)]

    def _window(self, recording: Recording, first: int, steps: int) -> sysid.SystemTrajectory:
        """Return `steps` super steps of the recording from `first` on."""
        controls = recording.controls[first : first + steps]
        held = np.repeat(controls, self.substeps, axis=0)
        held = np.vstack([held, held[-1:]])  # the toolbox drops the last
        times = self.model.opt.timestep * np.arange(len(held))
        measured = recording.measured[first + 1 : first + steps + 1]
        frames = recording.dt * np.arange(1, steps + 1)
        return sysid.SystemTrajectory(
            model=self.model,
            control=sysid.TimeSeries(times, held),
            sensordata=sysid.TimeSeries(frames, measured),
            initial_state=np.concatenate([[0.0], recording.measured[first]]),
            state=None,
        )

    def parameters(self) -> sysid.ParameterDict:
        """Return what it looks for, with nominal values and bounds."""
        known = self.system.parameters
        nominal = [parameter.nominal for parameter in known]
        low = [parameter.low for parameter in known]
        high = [parameter.high for parameter in known]
        parameters = sysid.ParameterDict()
        parameters.add(sysid.Parameter("body", nominal, low, high))
        if self.way.has_unknown_starts:
            room = START_BOUND * NOISE * np.tile(self.scale, len(self.starts))
            starts = self.starts.ravel()
            parameters.add(sysid.Parameter("starts", starts, starts - room, starts + room))
        return parameters

    def residuals(
        self, unknowns: Float[np.ndarray, " ..."], parameters: sysid.ParameterDict
    ) -> tuple[list[Float[np.ndarray, " ..."]], None, None]:
        """Return the residuals of one point (U,) or of several (U, N): (R,) or (R, N)."""
        rollout = self._rollout if self.way.has_unknown_starts else None
        found, _, _ = sysid.model_residual(
            unknowns,
            parameters,
            self._build,
            self.windows,
            modify_residual=self._compare,
            custom_rollout=rollout,
            n_threads=core_count(),
            resample_true=False,
        )
        if unknowns.ndim == 1:
            return [found], None, None
        # The toolbox makes a column of each window.
        columns = found.T.reshape(unknowns.shape[1], -1).T
        return [columns], None, None

    def _build(self, parameters: sysid.ParameterDict) -> mujoco.MjModel:
        assert self.system.family is not None
        return self.system.family.model_at(parameters["body"].value, self.model)

    def _rollout(
        self,
        initial_states: Sequence[np.ndarray],
        param_dicts: Sequence[sysid.ParameterDict],
        **arguments: Any,
    ) -> Sequence[sysid.SystemTrajectory]:
        """Return the toolbox's own rollout from unknown starts."""
        states = np.array(initial_states)
        starts = [parameters["starts"].value for parameters in param_dicts]
        states[:, 1:] = np.concatenate(starts).reshape(len(states), -1)
        arguments["control_signal"] = list(arguments["control_signal"])
        return sysid.sysid_rollout(
            arguments["models"],
            arguments["datas"],
            arguments["control_signal"],
            states,
            arguments["rollout_signal_mapping"],
            arguments["rollout_state_mapping"],
            arguments["ctrl_mapping"],
        )

    def _compare(
        self,
        parameters: sysid.ParameterDict,
        predicted: sysid.TimeSeries,
        measured: sysid.TimeSeries,
        model: mujoco.MjModel,
        return_all: bool,
        state: Float[np.ndarray, "N X"],
    ) -> tuple[Float[np.ndarray, "F S"], sysid.TimeSeries, sysid.TimeSeries]:
        """Return the residuals of one window at the recording's own times."""
        frames = state[self.substeps - 1 :: self.substeps, 1:]
        return (measured.data - frames) / self.scale, measured, measured


def run_toolbox(problem: Residuals, optimiser: str, limit: float) -> Outcome:
    """Return what the toolbox finds within `limit` seconds."""
    backend, settings = OPTIMISERS[optimiser]
    trials: list[tuple[float, Float[np.ndarray, " P"]]] = []
    parameters = problem.parameters()
    began = Clocks.now()

    def residuals(unknowns: np.ndarray, parameters: sysid.ParameterDict) -> Any:
        elapsed = began.passed().seconds
        if elapsed > limit:
            raise OutOfTimeError
        if unknowns.size == parameters.size:
            trials.append((elapsed, unknowns.ravel()[: problem.size].copy()))
        return problem.residuals(unknowns, parameters)

    iterations = 0
    try:
        # It prints a line an iteration.
        with contextlib.redirect_stdout(io.StringIO()):
            found, result = sysid.optimize(
                parameters,
                residuals,
                optimizer=backend,
                verbose=False,
                max_iters=MAX_ITERATIONS,
                **settings,
            )
    except OutOfTimeError:
        values = trials[-1][1]
        end = "out of time"
    else:
        values = found["body"].value
        end = "converged"
        is_mujoco = backend == "mujoco"
        iterations = len(result.extras["objective"]) - 1 if is_mujoco else result.njev
        if iterations >= MAX_ITERATIONS:
            end = "out of iterations"
    return Outcome(values, *began.passed(), iterations, tuple(trials), end)
