"""The basis of a soft body's shapes, states and contacts, for any physics."""

from __future__ import annotations

import abc
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.definitions.parts import BodySampling
from neuroanimator.physics.soft.own_frame import (
    ManyPoints,
    OwnMotion,
    seen_from_mover,
    seen_from_root,
)
from neuroanimator.physics.soft.program import MuscleMotion
from neuroanimator.physics.soft.soft_body import Played, Points
from neuroanimator.physics.starts import root_at_rest
from neuroanimator.physics.water import Water
from neuroanimator.state.gait import Gait
from neuroanimator.state.layout import Bounds
from neuroanimator.state.parameters import Parameter
from neuroanimator.state.shape_contacts import FREE, BoxCollider, RoundCollider, ShapeContacts
from neuroanimator.state.structure import Mirror
from neuroanimator.systems.movers import Movers, pace_of
from neuroanimator.systems.random_controls import sample_controls

CONTACT_REACH = 0.1
"""Distance at which features of contacts begin, over the size of the body."""

WORLD = np.zeros(())
"""The origin of the world, for any number of bodies."""


Paths = Float[np.ndarray, "F D ..."]
"""Poses of movers at the start and at the end of each frame."""

Parameters = Float[np.ndarray, "Q ..."]
"""Values of the parameters of each body."""


class Motion(NamedTuple):
    """A body at a moment; several side by side are the last axis."""

    positions: Float[np.ndarray, "N 3 ..."]
    """Positions from the origin [m]."""
    velocities: Float[np.ndarray, "N 3 ..."]
    """Velocities [m/s]."""
    origin: Float[np.ndarray, " ..."] = WORLD
    """Position of the origin in the world [m]: float32 is only precise near the body."""

    def recentred(self) -> Motion:
        """Return the same motion with an origin amid the nodes."""
        middle = self.positions.mean(axis=0)
        return Motion(self.positions - middle, self.velocities, self.origin + middle)


class SoftScene(abc.ABC):
    """A soft body of N nodes among M movers, one of which may be its anchor: its own frame moves and turns with it."""

    integrator: str
    """Name of its schemes."""
    lanes: int
    """Best number of bodies simulated side by side."""
    runs: int
    """Number of motions from which shapes are computed."""
    finding_step: float
    """Physics step of these motions [s]."""
    movers: Movers
    anchor: int
    """Number of the mover that holds the body; `FREE` if nothing holds it, `HELD` if the world does."""
    positions: Points
    """Positions of the nodes in the mesh or the model [m]."""
    faces: Int[np.ndarray, "F 3"]
    """Corners of the surface's triangles, counterclockwise from outside."""
    masses: Float[np.ndarray, " N"]
    """Masses of the nodes [kg]."""
    margin: float
    """Distance at which nodes touch colliders [m]."""
    capsules: tuple[RoundCollider, ...]
    boxes: tuple[BoxCollider, ...]
    ground_height: float | None
    """Height of the ground [m]; None without one."""
    wind: tuple[float, float, float]
    """Velocity of the air [m/s]."""
    has_ground: bool
    """Whether a plane is drawn at height zero."""
    parameters: tuple[Parameter, ...] = ()
    """Parameters, which vary from run to run."""
    muscles: tuple[str, ...] = ()
    """Names of the muscles, each a control from 0 to 1."""
    time_constant: float = 0.0
    """Time constant with which muscles follow their controls [s]."""
    water: Water | None = None
    mirror: Mirror | None = None
    """Left and right of the nodes and of the muscles, if there are muscles, and the mesh is its own mirror image."""
    gait: Gait | None = None
    sampling: BodySampling = BodySampling()
    """Random starts of a body in water."""
    rest_height: float = 0.0
    """Height added to the mesh at rest [m]."""

    @property
    def ground(self) -> float:
        """Height at which nodes touch the ground [m]; without one, minus infinity."""
        if self.ground_height is None:
            return -np.inf
        return self.ground_height + self.margin

    @property
    def size(self) -> float:
        """Longest edge of the body's bounding box at rest [m]."""
        return float(np.ptp(self.positions, axis=0).max())

    def random_paths(
        self,
        rng: np.random.Generator,
        starts: Float[np.ndarray, "B D"],
        rates: Float[np.ndarray, "B R"],
        steps: int,
        dt: float,
    ) -> Float[np.ndarray, "B T R"]:
        """Return rates of the movers along `Movers.random_paths`, fast enough to throw a body that nothing holds."""
        return self.movers.random_paths(rng, starts, rates, steps, dt, pace_of(self.anchor))

    @abc.abstractmethod
    def play(
        self,
        motion: Motion,
        paths: Paths,
        duration: float,
        steps: int,
        parameters: Parameters | None = None,
        muscles: MuscleMotion | None = None,
    ) -> Played:
        """Return positions from the motion's origin [m] and velocities [m/s] after each of F - 1 frames of `duration` [s].

        `paths` are the movers' poses at the start and at the end of each frame, `parameters`
        those of each body, by default nominal; muscles are idle by default.
        """

    def random_controls(
        self, rng: np.random.Generator, count: int, steps: int, dt: float
    ) -> Float[np.ndarray, "B T M"]:
        """Return random controls of the muscles: they pull, or are idle. Without muscles nothing is drawn from `rng`."""
        if not self.muscles:
            return np.zeros((count, steps, 0))
        both_ways = Bounds.symmetric(np.ones(len(self.muscles)))
        runs = [sample_controls(rng, steps, dt, both_ways, self.gait) for _ in range(count)]
        return np.stack(runs).clip(0, 1)

    def contracted(
        self,
        activations: Float[np.ndarray, "L M"],
        controls: Float[np.ndarray, "L T M"],
        dt: float,
    ) -> tuple[MuscleMotion, Float[np.ndarray, "L T M"]]:
        """Return (the muscles' motion from `activations` on, as `play` takes it, the activations after each control)."""
        motion = MuscleMotion(activations.T, np.moveaxis(controls, 0, -1))
        left = np.exp(-dt / self.time_constant) if self.time_constant else 0.0
        followed = np.empty_like(controls)
        for step in range(controls.shape[1]):
            activations = controls[:, step] + left * (activations - controls[:, step])
            followed[:, step] = activations
        return motion, followed

    def contacts(
        self,
        mean: Points,
        nodes: tuple[int, ...],
        modes: Float[np.ndarray, "K N 3"] | None = None,
    ) -> ShapeContacts:
        """Return the contacts of these `nodes` of a body with this mean and these modes, by default none."""
        if modes is None:
            modes = np.zeros((0, *mean.shape))
        return ShapeContacts(
            turning=self.movers.turning,
            anchor=self.anchor,
            capsules=self.capsules,
            boxes=self.boxes,
            ground=self.ground if np.isfinite(self.ground) else None,
            wind=self.wind,
            reach=CONTACT_REACH * self.size,
            nodes=nodes,
            mean=mean[list(nodes)],
            modes=modes[:, list(nodes)],
        )

    def centre(self, positions: Points) -> Float[np.ndarray, " 3"]:
        """Return the origin of the body's own frame [m] with its nodes at `positions`, and movers at rest."""
        if self.anchor == FREE:
            return np.average(positions, axis=0, weights=self.masses)
        if self.anchor < 0:
            return np.zeros(3)
        return self.movers.places[self.anchor].placement.origin(self.movers.rest)

    def state_at_rest(self, centre: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " S"]:
        """Return a state without its shapes: all at rest, a free body upright at `centre` [m]."""
        state = np.concatenate([self.movers.rest, np.zeros(self.movers.rate_size)])
        if self.anchor == FREE:
            state = np.concatenate([state, root_at_rest(centre)])
        return state

    def own_motion(
        self,
        positions: ManyPoints,
        velocities: ManyPoints,
        movers: Float[np.ndarray, "*B D"],
        rates: Float[np.ndarray, "*B R"],
        mean: Points,
        origin: Float[np.ndarray, " ..."] = WORLD,
    ) -> OwnMotion:
        """Return the motion of nodes in the body's own frame; `positions` are relative to `origin`, `mean` to the frame."""
        if self.anchor == FREE:
            own = seen_from_root(positions, velocities, mean, self.masses)
            own.root[..., :3] += origin
            return own
        if self.anchor < 0:
            still = np.zeros((*movers.shape[:-1], 3))
            return seen_from_mover(positions, velocities, still - origin, None, still)
        place = self.movers.places[self.anchor]
        position = place.placement.origin(movers) - origin
        orientation = place.placement.quaternions(movers)
        return seen_from_mover(
            positions, velocities, position, orientation, rates[..., place.rates]
        )
