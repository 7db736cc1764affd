"""A soft body and what moves: its definition and its mesh, made ready for the physics."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.definitions.soft import SoftDefinition
from neuroanimator.errors import ArgumentError
from neuroanimator.state.shape_contacts import BoxCollider, RoundCollider, ShapeContacts
from neuroanimator.systems.soft.mesh_file import Mesh
from neuroanimator.systems.soft.meshes import Cloth, Solid, cloth_body, solid_body, some
from neuroanimator.systems.soft.movers import Movers
from neuroanimator.systems.soft.own_frame import OwnMotion, seen_from_mover, seen_from_root
from neuroanimator.systems.soft.program import SoftProgram
from neuroanimator.systems.soft.soft_body import Air, Box, Capsule, Plane, SoftBody

CONTACT_REACH = 0.1
"""Distance from which contacts are shown, over the size of the body."""

WITHIN = 1e-3
"""Depth in a collider from which a node begins inside it, over the size of the body."""

WORLD = np.zeros(())
"""The origin of the world, for however many bodies."""


class Motion(NamedTuple):
    """A body at a moment; several side by side have a last axis for them."""

    positions: Float[np.ndarray, "N 3 ..."]
    """From the origin [m]."""
    velocities: Float[np.ndarray, "N 3 ..."]
    """[m/s]"""
    origin: Float[np.ndarray, " ..."] = WORLD
    """Position in the world [m]: float32 is exact near the body alone."""

    def recentred(self) -> Motion:
        """Return the same motion from an origin amid the nodes."""
        middle = self.positions.mean(axis=0)
        return Motion(self.positions - middle, self.velocities, self.origin + middle)


class Scene:
    """A soft body among M movers, the first of which that holds it is its anchor."""

    def __init__(self, definition: SoftDefinition, mesh: Mesh):
        """Raises ArgumentError for a mesh, a pin or a collider that cannot be."""
        self.definition = definition
        self.movers = Movers(definition.movers)
        holding = [number for number, mover in enumerate(self.movers.tables) if mover.pins]
        if not holding and not definition.is_solid:
            raise ArgumentError(
                "movers: nothing holds the cloth, and how it flies is not emulated. Give a mover pins."
            )
        self.anchor = holding[0] if holding else -1
        """Number of the mover that holds the body; -1 if none does."""
        if self.anchor < 0 and definition.ground is None:
            raise ArgumentError(
                "movers: nothing holds the body, and it falls for ever. Add a [ground], or give a mover pins."
            )
        self.body = self._body(mesh)
        self._refuse_overlap()

    def _body(self, mesh: Mesh) -> SoftBody:
        definition = self.definition
        movers = self.movers
        holders = np.repeat(
            np.arange(len(movers.tables)), [len(mover.pins) for mover in movers.tables]
        )
        pins = np.array([pin for mover in movers.tables for pin in mover.pins], int)
        if len(np.unique(pins)) < len(pins):
            raise ArgumentError("movers: a node is pinned twice. Leave it to one mover.")
        held = np.zeros((0, 3))
        if len(pins) and pins.max() < len(mesh.positions):
            rest = np.array([mover.position for mover in movers.tables])
            held = mesh.positions[pins] - rest[holders]
        planes: tuple[Plane, ...] = ()
        if definition.ground is not None:
            ground = definition.ground
            point = (0.0, 0.0, ground.height)
            planes = (Plane(friction=ground.friction, mover=len(movers.tables), point=point),)
        surroundings = {
            "air": Air(**definition.air.model_dump()),
            "capsules": tuple(self._capsules()),
            "boxes": tuple(self._boxes()),
            "planes": planes,
            "margin": definition.margin,
            "holders": holders,
            "held": held,
        }
        if definition.is_solid:
            solid = definition.solid
            material = Solid(solid.density, solid.stretch, solid.bulk, solid.damping)
            return solid_body(mesh.positions, mesh.elements, material, pins, **surroundings)
        cloth = definition.cloth
        material = Cloth(cloth.density, cloth.stretch, cloth.bend, cloth.damping)
        return cloth_body(mesh.positions, mesh.elements, material, pins, **surroundings)

    def _capsules(self) -> list[Capsule]:
        capsules = []
        for number, mover in enumerate(self.movers.tables):
            for collider in mover.colliders:
                if collider.radius is not None:
                    x, y, z = np.subtract(collider.end or collider.start, collider.start).tolist()
                    along = (x, y, z)
                    capsules.append(
                        Capsule(collider.radius, collider.friction, number, collider.start, along)
                    )
        return capsules

    def _boxes(self) -> list[Box]:
        boxes = []
        for number, mover in enumerate(self.movers.tables):
            for collider in mover.colliders:
                if collider.box is not None:
                    boxes.append(Box(collider.box, collider.friction, number, collider.start))
        return boxes

    @property
    def size(self) -> float:
        """Longest edge of the body's bounding box at rest [m]."""
        return float(np.ptp(self.body.positions, axis=0).max())

    @property
    def ground(self) -> float:
        """Height at which nodes touch the ground [m]; without one, minus infinity."""
        ground = self.definition.ground
        return -np.inf if ground is None else ground.height + self.body.margin

    def contacts(
        self,
        mean: Float[np.ndarray, "N 3"],
        modes: Float[np.ndarray, "K N 3"],
        nodes: tuple[int, ...],
    ) -> ShapeContacts:
        """Return the contacts of these `nodes` of a body with this mean and these modes."""
        body = self.body
        return ShapeContacts(
            turning=self.movers.turning,
            anchor=self.anchor,
            capsules=tuple(
                RoundCollider(one.mover, one.start, one.along, one.radius + body.margin)
                for one in body.capsules
            ),
            boxes=tuple(
                BoxCollider(one.mover, one.centre, one.half, body.margin) for one in body.boxes
            ),
            ground=self.ground if body.planes else None,
            wind=body.air.wind,
            reach=CONTACT_REACH * self.size,
            nodes=nodes,
            mean=mean[list(nodes)],
            modes=modes[:, list(nodes)],
        )

    def _refuse_overlap(self) -> None:
        """Raise ArgumentError, which names it, for a collider with nodes in it as the body lies in its mesh."""
        body = self.body
        free = np.setdiff1d(np.arange(len(body.positions)), body.pins)
        owners = [self.movers.names[one.mover] for one in (*body.capsules, *body.boxes)]
        mean = body.positions - self.centre(body.positions)
        contacts = self.contacts(mean, np.zeros((0, *mean.shape)), tuple(free.tolist()))
        distances = contacts.distances(self.state_at_rest(self.centre(body.positions)))
        for number, distance in enumerate(distances):
            inside = free[distance < -body.margin - WITHIN * self.size]
            if len(inside) and number < len(owners):
                raise ArgumentError(
                    f"movers: nodes {some(inside)} begin inside a collider of '{owners[number]}'. "
                    "Move it away, or make it smaller."
                )
            if len(inside):
                raise ArgumentError(f"ground: nodes {some(inside)} begin under it. Lower it.")

    def centre(self, positions: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, " 3"]:
        """Return the origin of the body's own frame [m] where its nodes are at `positions`, and movers at rest."""
        if self.anchor < 0:
            return np.average(positions, axis=0, weights=self.body.masses)
        entry = self.movers.places[self.anchor].entry
        return self.movers.rest[entry : entry + 3]

    def state_at_rest(self, centre: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " S"]:
        """Return a state but for its shapes: all at rest, a free body upright at `centre` [m]."""
        state = np.concatenate([self.movers.rest, np.zeros(self.movers.size)])
        if self.anchor < 0:
            upright = np.array([1.0, 0.0, 0.0, 0.0])
            state = np.concatenate([state, centre, upright, np.zeros(6)])
        return state

    def play(
        self, motion: Motion, paths: Float[np.ndarray, "F D ..."], duration: float, steps: int
    ) -> tuple[Float[np.ndarray, "F-1 N 3 ..."], Float[np.ndarray, "F-1 N 3 ..."]]:
        """Return positions from the motion's origin [m] and velocities [m/s] after each of F - 1 frames of `duration` [s].

        `paths` are the movers' positions [m] and headings [rad] at the start and at the end of each frame. See
        `SoftProgram.play`.
        """
        lanes = paths.shape[2] if paths.ndim > 2 else 1
        return SoftProgram(self.body, lanes).play(
            motion.positions,
            motion.velocities,
            self.movers.poses(paths, motion.origin),
            duration,
            steps,
        )

    def own_motion(
        self,
        positions: Float[np.ndarray, "*B N 3"],
        velocities: Float[np.ndarray, "*B N 3"],
        movers: Float[np.ndarray, "*B D"],
        rates: Float[np.ndarray, "*B D"],
        mean: Float[np.ndarray, "N 3"],
        origin: Float[np.ndarray, " ..."] = WORLD,
    ) -> OwnMotion:
        """Return the motion of nodes in the body's own frame; `positions` are from `origin`, `mean` is of the nodes in it."""
        if self.anchor < 0:
            own = seen_from_root(positions, velocities, mean, self.body.masses)
            own.root[..., :3] += origin
            return own
        place = self.movers.places[self.anchor]
        entries = slice(place.entry, place.entry + place.size)
        position = movers[..., entries].copy()
        position[..., :3] -= origin
        return seen_from_mover(positions, velocities, position, rates[..., entries])
