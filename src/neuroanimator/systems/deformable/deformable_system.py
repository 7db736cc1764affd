"""Deformable bodies: a System whose physics is a mass-spring body's."""

from __future__ import annotations

from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from neuroanimator.definitions.body import BodyDefinition, control_names
from neuroanimator.state.layout import Bounds, Layout, Slice
from neuroanimator.state.reference_shape import Cloud, to_world_axes
from neuroanimator.state.rotation import facing, multiply, rotated_by
from neuroanimator.state.segments import Lag, Points, PointVelocities, Segment
from neuroanimator.state.structure import Group, Probe, Structure
from neuroanimator.storage.program_cache import keep_programs
from neuroanimator.systems.deformable.body import Body
from neuroanimator.systems.deformable.bones import body_skeleton
from neuroanimator.systems.deformable.build import body_of, gait_of, group_numbers
from neuroanimator.systems.deformable.checks import check_steps
from neuroanimator.systems.deformable.mass_spring import BodyState, strains, trajectory
from neuroanimator.systems.deformable.mirror import mirror_of
from neuroanimator.systems.deformable.native.compiled import CTwin, c_twin
from neuroanimator.systems.schemes import schemes_of
from neuroanimator.systems.system import Scheme, System

DOUBLE_LANES = 8
"""Bodies side by side in C where numbers are float64: one AVX-512 register of them."""

ROWS = 256
"""Bodies simulated side by side: results do not depend on how many are asked for at once."""

BODIES, RUNNERS = 16, 64
"""How many bodies, and compiled motions of theirs, are kept: compiling one takes longer than most runs."""

MAX_STRAIN = 5.0
"""A spring stretched to more than this many times its length belongs to a body whose motion has diverged."""


class DeformableSystem(System):
    """A mass-spring body; its state is every mass point's place, then every speed, then muscle contractions."""

    def __init__(self, definition: BodyDefinition, definition_text: str = ""):
        """`definition_text` is what the system can be made from again; empty for one that comes with the package."""
        keep_programs()
        self.name = definition.name
        self.definition_text = definition_text
        self.body = _body(definition.model_dump_json())
        names = control_names(definition)
        self.control = Layout(tuple(Slice(name, 1, "1") for name in names))
        self.bounds = Bounds.symmetric(np.ones(len(names)))
        self.state = _state_layout(self.body, names)
        self.scheme, self.truth, self.fine = schemes_of(definition.physics)
        self.structure = _structure(definition, self.body)
        positions = self.body.positions + np.array([0.0, 0.0, self.body.rest_height])
        self.rest = self.pack(positions, np.zeros_like(positions), np.zeros(self.muscles))
        self.sampling, self.warm_up = definition.sampling, definition.sampling.warm_up
        self.skeleton = body_skeleton(self.body, definition.skin)
        self.gait = gait_of(definition)
        self.body_length = float(np.ptp(self.body.positions[:, 0]))
        self.has_ground = self.body.ground is not None
        self.water_surface = self.body.water.surface if self.body.water else None
        self.goals = self.goals_of(definition.goals)

    @property
    def muscles(self) -> int:
        """How many muscle contractions belong to the state."""
        return self.body.muscles.shape[1]

    def pack(
        self, positions: np.ndarray, velocities: np.ndarray, activations: np.ndarray
    ) -> np.ndarray:
        """Return states (..., S) from places and speeds (..., N, 3) and contractions (..., M)."""
        flat = (part.reshape(*part.shape[:-2], -1) for part in (positions, velocities))
        return np.concatenate([*flat, activations], axis=-1)

    def unpack(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return places and speeds (..., N, 3) and contractions (..., M) of states (..., S)."""
        size = 3 * len(self.body.masses)
        positions, velocities = states[..., :size], states[..., size : 2 * size]
        shape = (*states.shape[:-1], -1, 3)
        return positions.reshape(shape), velocities.reshape(shape), states[..., 2 * size :]

    def _simulate(
        self,
        states: np.ndarray,
        controls: np.ndarray,
        scheme: Scheme,
        substeps: int,
        threads: int,
    ) -> None:
        """Fill `states`, in float64; `threads` is JAX's own affair."""
        run = _runner(self.body, scheme, substeps)
        with jax.enable_x64(True):
            for first in range(0, len(states), ROWS):
                rows = slice(first, first + ROWS)
                states[rows, 1:] = self._run(run, states[rows, 0], controls[rows])

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

    def _run(self, run: Any, starts: np.ndarray, controls: np.ndarray) -> np.ndarray:
        """Return states (B, T, S): rows go last and come back first."""

        def last(array, axis=0):
            return jnp.asarray(np.moveaxis(array, axis, -1))

        motion = BodyState(*(last(part) for part in self.unpack(starts)))
        found = run(motion, jnp.asarray(np.moveaxis(controls, 0, -1)))
        return self.pack(*(np.moveaxis(np.asarray(part), -1, 0) for part in found))

    def has_diverged(self, states: np.ndarray) -> np.ndarray:
        """Return (B,) True for each run (B, T+1, S) that is not finite or has a spring stretched far too wide."""
        with np.errstate(all="ignore"):
            positions = np.moveaxis(self.unpack(states)[0], (2, 3), (0, 1))
            largest = np.abs(strains(self.body, positions)).max(axis=(0, 2))
        return ~np.isfinite(states).all(axis=(1, 2)) | (largest > MAX_STRAIN)

    def sample_starts(self, rng: np.random.Generator, count: int) -> np.ndarray:
        sampling, cloud = self.sampling, self.structure.cloud
        assert cloud is not None
        moving = (rng.random(count) >= sampling.rest_share)[:, None]
        rest = np.array(cloud.positions)
        shape = rest * (1 + rng.normal(size=(count, 1, 3)) * sampling.strain * moving[:, None])
        velocities = rng.normal(size=(count, 3)) * np.array(sampling.velocity) * moving
        angular_velocity = rng.normal(size=(count, 3)) * sampling.angular_velocity * moving
        orientation = self._turns(rng, count, moving)
        centre = cloud.centroid(self.unpack(self.rest)[0]) + np.zeros((count, 3))
        centre[:, 2] += rng.uniform(*sampling.height, count) * moving[:, 0]
        flow = velocities[:, None] + np.cross(angular_velocity[:, None], shape)
        activations = rng.uniform(-1, 1, (count, self.muscles)) * moving * 0.3
        return self.pack(
            centre[:, None] + to_world_axes(orientation, shape),
            to_world_axes(orientation, flow),
            activations,
        )

    def _turns(self, rng: np.random.Generator, count: int, moving: np.ndarray) -> np.ndarray:
        """Return quaternions (count, 4): any heading; any turn at all where there is no up and down."""
        if not self.body.has_gravity:
            anyhow = rng.normal(size=(count, 4))
            return anyhow / np.linalg.norm(anyhow, axis=1, keepdims=True)
        heading = facing(rng.uniform(-np.pi, np.pi, count))
        return multiply(
            heading,
            rotated_by(
                facing(np.zeros(count)), rng.normal(size=(count, 3)) * self.sampling.tilt * moving
            ),
        )


def _state_layout(body: Body, controls: list[str]) -> Layout:
    positions = [Slice(name, 3, "m") for name in body.names]
    velocities = [Slice(f"{name}.velocity", 3, "m/s") for name in body.names]
    activations = [
        Slice(f"{name}.contraction", 1, "1") for name in controls[: body.muscles.shape[1]]
    ]
    return Layout((*positions, *velocities, *activations))


def _structure(definition: BodyDefinition, body: Body) -> Structure:
    size, muscles = 3 * len(body.masses), body.muscles.shape[1]
    segments: list[Segment] = [Points(size=size, rate=size), PointVelocities(size=size)]
    if muscles:
        segments.append(Lag(size=muscles, time_constant=body.time_constant))
    return Structure(
        angles=(),
        rates=tuple((i, size + i) for i in range(size)),
        plain=(),
        segments=tuple(segments),
        cloud=Cloud.of(body.positions, body.masses),
        has_gravity=body.has_gravity,
        is_immersed=body.water is not None and body.ground is None,
        mirror=mirror_of(definition, body),
        probes=_probes(definition, body),
        groups=_groups(definition, body),
        external_forces=tuple(tuple(float(force) for force in row) for row in body.external_forces)
        if body.external_forces.any()
        else (),
    )


def _groups(definition: BodyDefinition, body: Body) -> tuple[Group, ...]:
    """Return the segments with the muscles that have an end in each."""
    pulls = np.abs(body.muscles) > 0
    found = []
    for name, points in group_numbers(definition).items():
        touched = np.isin(body.springs, points).any(axis=1)
        found.append(
            Group(name, points, tuple(int(c) for c in np.flatnonzero(pulls[touched].any(axis=0))))
        )
    return tuple(found)


def _probes(definition: BodyDefinition, body: Body) -> tuple[Probe, ...]:
    """Return the probes from the centroid; what is there as a radius is the height of the surface."""
    centre = body.masses @ body.positions / body.masses.sum()
    level = (body.water and body.water.surface) or 0.0
    return tuple(
        (float(x), float(y), float(z), level)
        for x, y, z in np.array(definition.probes).reshape(-1, 3) - centre
    )


@lru_cache(maxsize=BODIES)
def _body(text: str) -> Body:
    """Return the checked body of the definition in JSON: always the same one, as what is compiled for it is kept."""
    definition = BodyDefinition.model_validate_json(text)
    body = body_of(definition)
    check_steps(definition, body)
    return body


@lru_cache(maxsize=32)
def _double_twin(body: Body, lanes: int) -> CTwin | None:
    """Return the C twin in float64, `lanes` bodies at a time; None where there is no C compiler."""
    return c_twin(body, np.float64, lanes)


def _lanes_last(rows: np.ndarray) -> np.ndarray:
    """Return `rows` (lanes, ...) as the C twin takes them: (..., lanes), or (...) of one body alone."""
    if len(rows) == 1:
        return rows[0]
    return np.moveaxis(rows, 0, -1)


@lru_cache(maxsize=RUNNERS)
def _runner(body: Body, scheme: Scheme, steps: int) -> Any:
    """Return the compiled `trajectory` of `steps` physics steps per control."""
    return jax.jit(partial(trajectory, body, scheme.integrator, scheme.dt, steps))
