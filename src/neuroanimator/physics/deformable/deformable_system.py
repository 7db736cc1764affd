"""Deformable bodies: a System whose physics is that of a mass-spring body."""

from __future__ import annotations

from copy import copy
from functools import lru_cache
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Bool, Float
from numpy.lib.stride_tricks import sliding_window_view

from neuroanimator.codegen.jax_settings import keep_programs
from neuroanimator.definitions.body import BodyDefinition, control_names
from neuroanimator.physics.deformable.body import Body
from neuroanimator.physics.deformable.body_parameters import body_at, check_family, parameters_of
from neuroanimator.physics.deformable.bones import body_skeleton
from neuroanimator.physics.deformable.build import body_of
from neuroanimator.physics.deformable.checks import check_steps
from neuroanimator.physics.deformable.mass_spring import (
    BodyState,
    is_inside_out,
    strains,
    trajectory,
)
from neuroanimator.physics.deformable.native.compiled import CTwin, c_twin
from neuroanimator.physics.deformable.structure import state_layout, structure_of
from neuroanimator.physics.schemes import schemes_of
from neuroanimator.physics.starts import random_orientations
from neuroanimator.physics.state_parts import gait_of
from neuroanimator.state.layout import Bounds, Layout, Slice
from neuroanimator.state.parameters import (
    Parameter,
    draw_parameters,
    fixed_parameters,
    nominal_values,
)
from neuroanimator.state.reference_shape import points_of
from neuroanimator.state.rotation import to_world_axes
from neuroanimator.systems.system import Scheme, System

DOUBLE_LANES = 8
"""Number of bodies side by side in C in float64: one AVX-512 register."""

ROWS = 256
"""Number of bodies simulated side by side, fixed so that results do not depend on the size of a batch."""

MAX_BODIES = 16
"""Maximum number of bodies kept, each with its compiled programs: compiling takes longer than most runs."""

MAX_RUNNERS = 64
"""Maximum number of compiled trajectories kept, each for one body, scheme and number of steps."""

MAX_TWINS = 32
"""Maximum number of C twins kept, each for one body and number of lanes."""

MAX_STRAIN = 5.0
"""Maximum strain of a spring: beyond it the motion has diverged."""

STUCK = 3
"""Number of successive states inside out that count as divergence: a sharp turn may press a tail through for one."""

START_ACTIVATION = 0.3
"""Largest activation of the muscles in a random start: motions begin with muscles neither slack nor cramped."""


class DeformableSystem(System):
    """A mass-spring body; its state is every mass point's position, then every velocity, muscle activations, parameters."""

    def __init__(self, definition: BodyDefinition, definition_text: str = ""):
        """`definition_text` is the text from which the system can be made again; empty for a shipped one."""
        keep_programs()
        self.name = definition.name
        self.definition_text = definition_text
        self.body, self.parameters = _body(definition.model_dump_json())

        controls = control_names(definition)
        self.control = Layout(tuple(Slice(name, 1, "1") for name in controls))
        self.bounds = Bounds.symmetric(np.ones(len(controls)))
        self.state = state_layout(definition, self.body, self.parameters)
        self.structure = structure_of(definition, self.body, self.parameters)
        self.rest = self._at_rest()

        self.scheme, self.truth, self.fine = schemes_of(definition.physics)
        self.sampling = definition.sampling
        self.is_pushed = bool(definition.external_forces)
        self.warm_up = definition.sampling.warm_up
        self.gait = gait_of(definition.gait, controls)
        self.goals = self.goals_of(definition.goals)

        self.skeleton = body_skeleton(self.body, definition.skin)
        self.body_length = float(np.ptp(self.body.positions[:, 0]))
        self.has_ground = self.body.ground is not None
        self.water_surface = self.body.water.surface if self.body.water else None

    @property
    def muscles(self) -> int:
        """Number of muscle activations in the state."""
        return self.body.muscles.shape[1]

    def pack(
        self,
        positions: Float[np.ndarray, "*B N 3"],
        velocities: Float[np.ndarray, "*B N 3"],
        activations: Float[np.ndarray, "*B M"],
        parameters: Float[np.ndarray, "*B Q"] | None = None,
    ) -> Float[np.ndarray, "*B S"]:
        """Return states from positions [m], velocities [m/s], activations, and parameters, nominal if not given."""
        batch = positions.shape[:-2]
        if parameters is None:
            nominal = nominal_values(self.parameters)
            parameters = np.broadcast_to(nominal, (*batch, len(nominal)))
        flat = (positions.reshape(*batch, -1), velocities.reshape(*batch, -1))
        return np.concatenate([*flat, activations, parameters], axis=-1)

    def unpack(
        self, states: Float[np.ndarray, "*B S"]
    ) -> tuple[Float[np.ndarray, "*B N 3"], Float[np.ndarray, "*B N 3"], Float[np.ndarray, "*B M"]]:
        """Return positions [m], velocities [m/s] and activations of states."""
        size = 3 * len(self.body.masses)
        positions = states[..., :size]
        velocities = states[..., size : 2 * size]
        activations = states[..., 2 * size : self.parameter_entries.start]
        shape = (*states.shape[:-1], -1, 3)
        return positions.reshape(shape), velocities.reshape(shape), activations

    def at(self, /, **values: float) -> DeformableSystem:
        """Return the body of this family with the given parameters, or the smaller family, at rest in its own shape.

        Raises ArgumentError for a name that is not a parameter, and for a value out of range.
        """
        fixed = copy(self)
        fixed.parameters = fixed_parameters(self.parameters, values)
        fixed.rest = self.start_at(values)
        return fixed

    def _at_rest(self) -> Float[np.ndarray, " S"]:
        positions = body_at(self.body, nominal_values(self.parameters)).positions
        positions = positions + np.array([0.0, 0.0, self.body.rest_height])
        return self.pack(positions, np.zeros_like(positions), np.zeros(self.muscles))

    def _simulate(
        self,
        states: np.ndarray,
        controls: np.ndarray,
        scheme: Scheme,
        substeps: int,
        threads: int,
    ) -> None:
        """Fill `states`, in float64; JAX ignores `threads`."""
        run = _runner(self.body, scheme, substeps)
        with jax.enable_x64(True):
            for first in range(0, len(states), ROWS):
                rows = slice(first, first + ROWS)
                states[rows, 1:] = self._run(run, states[rows, 0], controls[rows])

    def _run(
        self, run: Any, starts: Float[np.ndarray, "B S"], controls: Float[np.ndarray, "B T C"]
    ) -> Float[np.ndarray, "B T S"]:
        """Return the states after each control; `run` takes and returns rows last."""
        positions, velocities, activations = (_rows_last(part) for part in self.unpack(starts))
        parameters = starts[:, self.parameter_entries]
        path = run(
            BodyState(positions, velocities, activations),
            _rows_last(controls),
            _rows_last(parameters),
        )
        positions, velocities, activations = (np.moveaxis(np.asarray(p), -1, 0) for p in path)
        held = np.repeat(parameters[:, None], controls.shape[1], axis=1)
        return self.pack(positions, velocities, activations, held)

    def _simulate_fastest(
        self, states: np.ndarray, controls: np.ndarray, scheme: Scheme, substeps: int
    ) -> None:
        lanes = 1 if len(states) == 1 else DOUBLE_LANES
        twin = _double_twin(self.body, lanes)
        if twin is None:
            super()._simulate_fastest(states, controls, scheme, substeps)
            return
        for first in range(0, len(states), lanes):
            rows = np.arange(first, first + lanes).clip(max=len(states) - 1)
            start = _lanes_last(states[rows, 0])
            held = _lanes_last(controls[rows])
            path = twin.play(start, held, scheme.integrator, scheme.dt, substeps)
            states[rows, 1:] = path[None] if lanes == 1 else np.moveaxis(path, -1, 0)

    def has_diverged(self, states: np.ndarray) -> np.ndarray:
        """Return whether each run (B, T+1, S) is not finite, tears a spring, or stays inside out."""
        has_diverged = np.zeros(len(states), bool)
        for first in range(0, len(states), ROWS):
            rows = slice(first, first + ROWS)
            has_diverged[rows] = self._rows_have_diverged(states[rows])
        return has_diverged

    def _rows_have_diverged(self, states: np.ndarray) -> np.ndarray:
        is_finite = np.isfinite(states).all(axis=(1, 2))
        with np.errstate(all="ignore"):
            points = self.unpack(states)[0]
            positions = np.moveaxis(points, (2, 3), (0, 1))
            parameters = np.moveaxis(states[:, :1, self.parameter_entries], 2, 0)
            body = body_at(self.body, parameters)
            largest = np.abs(strains(body, positions)).max(axis=(0, 2))
            is_stuck = _goes_on(is_inside_out(self.body, points), STUCK)
        return ~is_finite | (largest > MAX_STRAIN) | is_stuck

    def kinetic_energies(self, states: np.ndarray) -> np.ndarray:
        _, velocities, _ = self.unpack(states)
        body = body_at(self.body, np.moveaxis(states[..., self.parameter_entries], -1, 0))
        masses = np.moveaxis(body.masses, 0, -1)
        return np.einsum("...n,...nk,...nk->...", masses, velocities, velocities) / 2

    def sample_starts(self, rng: np.random.Generator, count: int) -> np.ndarray:
        sampling = self.sampling
        cloud = self.structure.cloud
        assert cloud is not None
        is_moving = (rng.random(count) >= sampling.rest_share)[:, None]
        stretch = rng.normal(size=(count, 1, 3)) * sampling.strain * is_moving[:, None]
        parameters = draw_parameters(self.parameters, rng, count)
        grown = np.array(cloud.positions) + points_of(cloud.growth(parameters))
        shape = grown * (1 + stretch)
        velocity = rng.normal(size=(count, 3)) * np.array(sampling.velocity) * is_moving
        angular_velocity = rng.normal(size=(count, 3)) * sampling.angular_velocity * is_moving
        orientation = random_orientations(sampling, rng, is_moving, self.body.has_gravity)
        centre = cloud.centroid(self.unpack(self.rest)[0]) + np.zeros((count, 3))
        centre[:, 2] += rng.uniform(*sampling.height, count) * is_moving[:, 0]
        activations = rng.uniform(-1, 1, (count, self.muscles)) * is_moving * START_ACTIVATION
        local_velocities = velocity[:, None] + np.cross(angular_velocity[:, None], shape)
        positions = centre[:, None] + to_world_axes(orientation, shape)
        velocities = to_world_axes(orientation, local_velocities)
        return self.pack(positions, velocities, activations, parameters)

    def sample_resets(self, rng: np.random.Generator, count: int) -> np.ndarray:
        cloud = self.structure.cloud
        assert cloud is not None
        parameters = draw_parameters(self.parameters, rng, count)
        return np.stack([cloud.reshaped(self.rest, values) for values in parameters])


def _rows_last(rows: np.ndarray) -> Array:
    """Return `rows` (B, ...) as the physics in JAX takes them, (..., B), without compiling anything."""
    return jax.device_put(np.array(np.moveaxis(rows, 0, -1), order="C"))


def _lanes_last(rows: np.ndarray) -> np.ndarray:
    """Return `rows` (lanes, ...) as the C twin takes them: (..., lanes), or (...) for a single body."""
    if len(rows) == 1:
        return rows[0]
    return np.moveaxis(rows, 0, -1)


@lru_cache(maxsize=MAX_BODIES)
def _body(text: str) -> tuple[Body, tuple[Parameter, ...]]:
    """Return the checked body of the definition in JSON and its parameters.

    It is always the same object, as its compiled code is kept.
    """
    definition = BodyDefinition.model_validate_json(text)
    body = body_of(definition)
    check_steps(definition, body)
    parameters = parameters_of(definition.parameters, body)
    check_family(definition, body, parameters)
    return body, parameters


@lru_cache(maxsize=MAX_TWINS)
def _double_twin(body: Body, lanes: int) -> CTwin | None:
    """Return the C twin in float64, `lanes` bodies at a time; None without a C compiler."""
    return c_twin(body, np.float64, lanes)


@lru_cache(maxsize=MAX_RUNNERS)
def _runner(body: Body, scheme: Scheme, steps: int) -> Any:
    """Return the compiled `trajectory` of `steps` physics steps per control, whose last argument is the bodies' parameters."""

    def run(start: BodyState, controls: Array, parameters: Float[Array, "Q B"]) -> BodyState:
        of_parameters = body_at(body, parameters)
        return trajectory(of_parameters, scheme.integrator, scheme.dt, steps, start, controls)

    return jax.jit(run)


def _goes_on(is_so: Bool[np.ndarray, "B T"], count: int) -> Bool[np.ndarray, " B"]:
    """Return whether each run has `count` successive True entries."""
    if is_so.shape[1] < count:
        return np.zeros(len(is_so), bool)
    windows = sliding_window_view(is_so, count, axis=-1)
    return np.asarray(windows.all(axis=-1).any(axis=-1))
