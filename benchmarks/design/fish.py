"""A fish that is to come far for little effort: what is asked of it, and what that costs on its physics in C."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import neuroanimator as na
from benchmarks.control.baselines.cost_evaluator import DIVERGED_COST
from benchmarks.control.baselines.fast_physics import threads
from benchmarks.control.baselines.run_baseline import population
from benchmarks.identification.recordings import Recording
from neuroanimator.control import Periodic
from neuroanimator.control.descent.descend import start_of_body
from neuroanimator.control.descent.problem import VariedParameters
from neuroanimator.control.objective.objective import Trajectory
from neuroanimator.physics.deformable.deformable_system import DeformableSystem
from neuroanimator.physics.deformable.native.compiled import SINGLE_LANES, c_twin
from neuroanimator.state.pose import read_pose
from neuroanimator.systems.random_controls import sample_controls

SECONDS = 3.0
"""Length of the motion [s]: six strokes, in which the fish comes about half its length."""

FAR = 1.0
"""Distance that is asked for [m]: more than any of them can come."""

WITHIN = 0.05
"""Distance [m] whose lack costs as much as an error of one."""

EFFORT = 5.0
"""Weight of effort: at 1 all muscles are driven as hard as they can be."""

STRENGTH = 0.7
"""First guesses are the gait at this strength, as for the tasks of swimmers."""

RECORDED = 4.0
"""Length of a recording [s]."""

NOISE = 0.0005
"""Standard deviation of the noise of recorded places [m]."""

VARIED = ("length", "stiffness")
"""Parameters that are searched for, beside the gait."""


class Problem(NamedTuple):
    """What is searched for, and by which numbers."""

    system: DeformableSystem
    objective: na.Objective
    start: Float[np.ndarray, " S"]
    parametrisation: Periodic
    first: Float[np.ndarray, "T C"]
    dt: float

    @property
    def steps(self) -> int:
        """Number of super steps of the motion."""
        return self.parametrisation.steps


def pose_fish(emulator: na.Emulator) -> Problem:
    """Return the problem of a family of fish, from rest."""
    system = na.load_system(emulator.system)
    assert isinstance(system, DeformableSystem)
    assert system.gait is not None
    steps = round(SECONDS / emulator.dt)
    forward = read_pose(system.structure, system.rest).forward
    objective = na.Objective.of(
        na.effort(EFFORT),
        na.smoothness(0.001),
        na.stay_upright(system, weight=0.3),
        na.travel(system, forward, FAR, within=WITHIN),
    )
    gait = system.gait.controls(steps, emulator.dt, system.bounds)
    parametrisation = Periodic.of(steps, emulator.dt, system.gait.period, system.bounds)
    return Problem(system, objective, system.rest, parametrisation, STRENGTH * gait, emulator.dt)


class CostInC:
    """J of gaits and bodies by the physics in C, sixteen bodies side by side: what CMA-ES asks for."""

    def __init__(self, emulator: na.Emulator, problem: Problem, varied: VariedParameters):
        twin = c_twin(problem.system.body, np.float32, SINGLE_LANES)
        assert twin is not None
        self._problem = problem
        self._varied = varied
        self._twin = twin
        self._substeps = problem.system.scheme.steps(problem.dt)
        self.batch = population(varied.size, SINGLE_LANES)
        """Number of motions at a time."""
        self.physics = self
        self.steps = self._substeps * problem.steps
        """Physics steps of a motion."""
        scale = jnp.asarray(problem.system.bounds.magnitude, jnp.float32)

        def cost(states: Float[Array, "T1 S"], controls: Float[Array, "T C"]) -> Array:
            return problem.objective(Trajectory(states, controls, scale, problem.dt))

        self._costs = jax.jit(jax.vmap(cost))
        self._controls = jax.jit(jax.vmap(varied.controls))
        self._values = jax.jit(jax.vmap(varied.values))
        own = problem.start[list(varied.entries)]
        self._own = own.astype(np.float32)
        growth = []
        for unit in np.eye(len(own)):
            start = start_of_body(emulator, problem.start, varied.entries, own + unit)
            growth.append(start - problem.start)
        self._growth = np.stack(growth).astype(np.float32)
        """(P, S) change of the start per unit of each parameter."""

    def costs(self, zs: Float[np.ndarray, "B Z"]) -> Float[np.ndarray, " B"]:
        """Return J of each row: numbers of a gait, then of a body."""
        count = len(zs)
        rows = np.asarray(zs, np.float32)[np.arange(self.batch).clip(max=count - 1)]
        controls = np.asarray(self._controls(rows))
        values = np.asarray(self._values(rows))
        starts = self._problem.start.astype(np.float32) + (values - self._own) @ self._growth
        return self._costs_of(starts, controls)[:count]

    def cost_of(self, start: Float[np.ndarray, " S"], controls: Float[np.ndarray, "T C"]) -> float:
        """Return J of one motion by the same physics."""
        starts = np.tile(start.astype(np.float32), (self.batch, 1))
        held = np.tile(controls.astype(np.float32), (self.batch, 1, 1))
        return float(self._costs_of(starts, held)[0])

    def _costs_of(
        self, starts: Float[np.ndarray, "B S"], controls: Float[np.ndarray, "B T C"]
    ) -> Float[np.ndarray, " B"]:
        states = np.empty((self.batch, self._problem.steps + 1, starts.shape[1]), np.float32)
        states[:, 0] = starts
        scheme = self._problem.system.scheme

        def play(first: int) -> None:
            group = slice(first, first + SINGLE_LANES)
            held = np.moveaxis(controls[group], 0, -1)
            path = self._twin.play(
                starts[group].T, held, scheme.integrator, scheme.dt, self._substeps
            )
            states[group, 1:] = np.moveaxis(path, -1, 0)

        list(threads().map(play, range(0, self.batch, SINGLE_LANES)))
        costs = np.asarray(self._costs(states, controls), float)
        return np.where(np.isfinite(costs), costs, DIVERGED_COST)


def first_guess(problem: Problem, varied: VariedParameters) -> Float[np.ndarray, " Z"]:
    """Return the numbers of the first gait and the nominal body."""
    values = problem.start[list(varied.entries)]
    shares = (values - np.asarray(varied.middle)) / np.asarray(varied.half)
    return np.concatenate([problem.parametrisation.guess(problem.first), np.arctanh(shares)])


def record_fish(system: na.System, dt: float, seed: int) -> Recording:
    """Return a motion of a random fish: places of its mass points at the start and after each super step."""
    rng = np.random.default_rng(seed)
    values = {p.name: float(rng.uniform(p.low, p.high)) for p in system.parameters}
    fish = system.at(**values)
    assert fish.gait is not None
    assert fish.structure.cloud is not None
    steps = round(RECORDED / dt)
    gait = fish.gait.controls(steps, dt, fish.bounds)
    controls = 0.5 * gait + 0.5 * sample_controls(rng, steps, dt, fish.bounds)
    states = fish.simulate_fastest(fish.rest[None], controls[None], dt).states[0]
    places = states[:, : 3 * fish.structure.cloud.count]
    measured = places + NOISE * rng.normal(size=places.shape)
    return Recording(np.array(list(values.values())), measured, controls, dt)


class Swim(NamedTuple):
    """What a gait of a body does on the true physics."""

    cost: float
    distance: float
    """Distance of the centroid ahead [m]."""
    effort: float
    """∫ |u|² dt of all muscles [s]."""


def swim_truly(
    problem: Problem, start: Float[np.ndarray, " S"], controls: Float[np.ndarray, "T C"]
) -> Swim:
    """Return what `controls` do from `start` by the scheme of the truth."""
    system = problem.system
    states = system.simulate_fastest(start[None], controls[None], problem.dt).states[0]
    scale = np.asarray(system.bounds.magnitude)
    cost = float(problem.objective(Trajectory(states, controls, scale, problem.dt)))
    begin = read_pose(system.structure, states[0])
    end = read_pose(system.structure, states[-1])
    distance = float((end.position - begin.position) @ begin.forward)
    return Swim(cost, distance, float(np.sum((controls / scale) ** 2) * problem.dt))
