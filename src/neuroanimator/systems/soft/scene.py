"""A cloth and what moves: its definition and its mesh, made ready for the physics."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.definitions.soft import SoftDefinition
from neuroanimator.errors import ArgumentError
from neuroanimator.systems.soft.meshes import Cloth, cloth_body
from neuroanimator.systems.soft.program import LANES, SoftProgram
from neuroanimator.systems.soft.soft_body import Air, Capsule, Plane


class Scene:
    """A soft body among M movers, the first of which that holds it is its anchor."""

    integrator = "xpbd"
    """Name of its schemes: extended position-based dynamics in small steps."""

    lanes = LANES
    """Number of bodies that are best played side by side."""

    runs = LANES
    """Number of motions in which shapes are looked for."""

    def __init__(
        self,
        definition: SoftDefinition,
        positions: Float[np.ndarray, "N 3"],
        faces: Int[np.ndarray, "F 3"],
    ):
        """Raises ArgumentError for a mesh, a pin or a collider that cannot be."""
        self.finding_step = definition.physics.truth_step
        """The step with which shapes are looked for [s]."""
        self.movers = list(definition.movers.values())
        self.rest = np.array([mover.position for mover in self.movers])
        holding = [number for number, mover in enumerate(self.movers) if mover.pins]
        if not holding:
            raise ArgumentError(
                "movers: nothing holds the cloth, and how it flies is not emulated. Give a mover pins."
            )
        self.anchor = holding[0]
        self._holder_of = np.repeat(
            np.arange(len(self.movers)), [len(mover.pins) for mover in self.movers]
        )
        pins = np.array([pin for mover in self.movers for pin in mover.pins], int)
        material = definition.cloth
        capsules = [
            Capsule(collider.radius, collider.friction)
            for mover in self.movers
            for collider in mover.colliders
        ]
        planes: tuple[Plane, ...] = ()
        self._points = np.zeros((0, 3))
        if definition.ground is not None:
            planes = (Plane(friction=definition.ground.friction),)
            self._points = np.array([[0.0, 0.0, definition.ground.height]])
        self.body = cloth_body(
            positions,
            faces,
            Cloth(material.density, material.stretch, material.bend, material.damping),
            pins,
            air=Air(**definition.air.model_dump()),
            capsules=tuple(capsules),
            planes=planes,
            margin=material.thickness / 2,
        )
        if len(np.unique(pins)) < len(pins):
            raise ArgumentError("movers: a node is pinned twice. Leave it to one mover.")
        self._held = positions[pins] - self.rest[self._holder_of]

    @property
    def has_ground(self) -> bool:
        """Whether it lies over a plane that is drawn at height zero."""
        return len(self._points) > 0

    @property
    def positions(self) -> Float[np.ndarray, "N 3"]:
        """Positions of the nodes as the mesh has them [m]."""
        return self.body.positions

    @property
    def faces(self) -> Int[np.ndarray, "F 3"]:
        """Corners of the triangles."""
        return self.body.faces

    @property
    def margin(self) -> float:
        """Distance at which nodes touch colliders [m]."""
        return self.body.margin

    @property
    def size(self) -> float:
        """Longest edge of the cloth's bounding box at rest [m]."""
        return float(np.ptp(self.body.positions, axis=0).max())

    def play(
        self, motion: Motion, paths: Float[np.ndarray, "F M 3 ..."], duration: float, steps: int
    ) -> tuple[Float[np.ndarray, "F-1 N 3 ..."], Float[np.ndarray, "F-1 N 3 ..."]]:
        """Return positions [m] and velocities [m/s] after each of F - 1 frames; see `SoftProgram.play`.

        `paths` are the movers' positions [m] at the start and at the end of each frame.
        """
        lanes = paths.shape[3] if paths.ndim > 3 else 1
        tail = (1,) * (paths.ndim - 3)
        pins = paths[:, self._holder_of] + self._held.reshape(*self._held.shape, *tail)
        return SoftProgram(self.body, lanes).play(
            motion.positions, motion.velocities, pins, self._collider_paths(paths), duration, steps
        )

    def _collider_paths(
        self, paths: Float[np.ndarray, "F M 3 ..."]
    ) -> Float[np.ndarray, "F X ..."]:
        """Return the rows of colliders as `SoftProgram.play` takes them."""
        tail = (1,) * (paths.ndim - 3)
        rows = []
        for number, mover in enumerate(self.movers):
            for collider in mover.colliders:
                start = np.array(collider.start)
                end = start if collider.end is None else np.array(collider.end)
                rows.append(paths[:, number] + start.reshape(3, *tail))
                rows.append(
                    np.broadcast_to((end - start).reshape(3, *tail), paths[:, number].shape)
                )
        for point in self._points:
            rows.append(np.broadcast_to(point.reshape(3, *tail), paths[:, 0].shape))
        if not rows:
            return np.zeros((len(paths), 0, *paths.shape[3:]))
        return np.concatenate(rows, axis=1)


def anchor_of(anchor: int, movers: Float[np.ndarray, "F M 3 ..."]) -> Float[np.ndarray, "F 3 ..."]:
    """Return the positions, or velocities, of the mover that all nodes go with; zeros if there is none (-1)."""
    if anchor < 0:
        return np.zeros_like(movers[:, 0])
    return movers[:, anchor]


class Motion(NamedTuple):
    """A body at a moment; several side by side have a last axis for them."""

    positions: Float[np.ndarray, "N 3 ..."]
    """[m]"""
    velocities: Float[np.ndarray, "N 3 ..."]
    """[m/s]"""
