"""Cloths as a System: the state holds what moves them and the amplitudes of their shapes, the physics all their nodes."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import mujoco
import numpy as np
from jaxtyping import Bool, Float

from neuroanimator.appearance.skeleton import Bone, Shape, Skeleton
from neuroanimator.definitions.flex import FlexDefinition
from neuroanimator.definitions.soft import MoverTable, SoftDefinition
from neuroanimator.state.layout import Bounds, Layout, Slice
from neuroanimator.state.links import Joint
from neuroanimator.state.segments import Driven, Lag, Plain
from neuroanimator.state.shape_contacts import Collider, ShapeContacts
from neuroanimator.state.structure import Structure
from neuroanimator.systems.soft.flex_bones import scenery, shapes_below
from neuroanimator.systems.soft.flex_scene import FlexScene
from neuroanimator.systems.soft.scene import Motion, Scene, anchor_of
from neuroanimator.systems.soft.shape_file import ShapeFile
from neuroanimator.systems.system import Scheme, System

BLOCK = 8
"""Number of super steps simulated at once: memory grows with it."""

CONTACT_NODES = 81
"""Number of nodes whose contacts an emulator is shown."""

CONTACT_REACH = 0.1
"""Distance from which contacts are shown, over the size of the body."""

MAX_AMPLITUDE = 20.0
"""Amplitude over the size of the body at which a motion has diverged."""

REST_SHARE = 0.2
"""Share of random starts at rest."""

COLOUR = (0.75, 0.75, 0.78, 1.0)
"""Colour of colliders."""


class SoftSystem(System):
    """A cloth; its state is movers' positions and velocities, then amplitudes of shapes, then their rates.

    Physics starts from nodes put together of the shapes, and then goes on with all nodes; what a state holds of them is
    the part of their motion that the shapes can tell.
    """

    is_self_contained = False

    def __init__(
        self,
        definition: SoftDefinition | FlexDefinition,
        scene: Scene | FlexScene,
        file: ShapeFile,
        definition_text: str = "",
    ):
        """`scene` is that of the definition, `definition_text` what the system can be made from again."""
        self.name = definition.name
        self.definition_text = definition_text
        self.shapes = file.shapes
        self.starts = file.starts
        self.scene = scene
        self.rest = file.starts[0]
        physics = definition.physics
        self.scheme = Scheme(scene.integrator, physics.step)
        self.truth = Scheme(scene.integrator, physics.truth_step)
        self.fine = Scheme(scene.integrator, physics.fine_step)
        names = list(definition.movers)
        count = len(self.shapes.modes)
        self.state = Layout(
            (
                *(Slice(name, 3, "m") for name in names),
                *(Slice(f"{name}_velocity", 3, "m/s") for name in names),
                Slice("shapes", count, "m"),
                Slice("shape_rates", count, "m/s"),
            )
        )
        self.control = Layout(tuple(Slice(name, 3, "m/s") for name in names))
        self.bounds = Bounds.symmetric(np.concatenate([mover.speed for mover in self.scene.movers]))
        self.structure = self._structure()
        self.skeleton = Skeleton(tuple(self._bones(names)), shapes=self.shapes)
        self.body_length = self.scene.size
        self.has_ground = scene.has_ground
        self.goals = self.goals_of(definition.goals)

    def _structure(self) -> Structure:
        first = self.shapes.first
        count = len(self.shapes.modes)
        amplitudes = range(first, first + count)
        rates = tuple((entry, entry + count) for entry in amplitudes)
        return Structure(
            angles=(),
            rates=rates,
            plain=tuple(range(first // 2, first + 2 * count)),
            segments=(
                Driven(size=first // 2),
                Lag(size=first // 2),
                Plain(size=2 * count),
            ),
            has_gravity=False,
            shape_contacts=self._contacts(),
        )

    def _contacts(self) -> ShapeContacts:
        nodes = _spread_nodes(self.shapes.mean, CONTACT_NODES, 2 * self.scene.margin)
        margin = self.scene.margin
        colliders = []
        for number, mover in enumerate(self.scene.movers):
            for collider in mover.colliders:
                end = collider.start if collider.end is None else collider.end
                along = tuple(float(value) for value in np.subtract(end, collider.start))
                colliders.append(Collider(number, collider.start, along, collider.radius + margin))
        return ShapeContacts(
            movers=len(self.scene.movers),
            anchor=self.scene.anchor,
            colliders=tuple(colliders),
            reach=CONTACT_REACH * self.scene.size,
            nodes=nodes,
            mean=self.shapes.mean[list(nodes)],
            modes=self.shapes.modes[:, list(nodes)],
        )

    def _bones(self, names: list[str]) -> list[Bone]:
        bones = []
        if isinstance(self.scene, FlexScene):
            bones += scenery(self.scene.model, self.scene.data)
        for number, (name, mover) in enumerate(zip(names, self.scene.movers, strict=True)):
            axes = np.eye(3).tolist()
            joints = tuple(
                Joint("slide", 3 * number + axis, tuple(axes[axis]), (0.0, 0.0, 0.0))
                for axis in range(3)
            )
            shapes = self._drawn(number, mover)
            upright = (1.0, 0.0, 0.0, 0.0)
            bones.append(Bone(name, -1, (0.0, 0.0, 0.0), upright, joints, shapes))
        return bones

    def _drawn(self, number: int, mover: MoverTable) -> tuple[Shape, ...]:
        """Return what is drawn of a mover: its geoms, or its colliders."""
        scene = self.scene
        if isinstance(scene, FlexScene):
            return shapes_below(scene.model, scene.data, scene.bodies[number])
        shapes = []
        for collider in mover.colliders:
            start = np.array(collider.start)
            along = np.zeros(3) if collider.end is None else np.array(collider.end) - start
            shapes.append(_shape(start, along, collider.radius))
        return tuple(shapes)

    def motion(self, states: Float[np.ndarray, "L S"]) -> Motion:
        """Return the nodes of states, side by side: (N, 3, L) each."""
        positions = self.shapes.decode(states)
        first = self.shapes.first
        count = len(self.shapes.modes)
        rates = states[:, first + count :]
        velocities = np.tensordot(rates, self.shapes.modes, axes=1)
        moving = states[:, first // 2 : first].reshape(len(states), -1, 3)
        velocities += anchor_of(self.scene.anchor, moving)[:, None]
        return Motion(np.moveaxis(positions, 0, -1), np.moveaxis(velocities, 0, -1))

    def _simulate(
        self,
        states: Float[np.ndarray, "B _ S"],
        controls: Float[np.ndarray, "B T C"],
        scheme: Scheme,
        substeps: int,
        threads: int,
    ) -> None:
        lanes = self.scene.lanes
        groups = [
            np.arange(first, first + lanes).clip(max=len(states) - 1)
            for first in range(0, len(states), lanes)
        ]

        def run(rows: np.ndarray) -> None:
            states[rows, 1:] = self._run(states[rows, 0], controls[rows], scheme, substeps)

        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(run, groups))

    def _run(
        self,
        starts: Float[np.ndarray, "L S"],
        controls: Float[np.ndarray, "L T C"],
        scheme: Scheme,
        substeps: int,
    ) -> Float[np.ndarray, "L T S"]:
        """Return the states after each control."""
        dt = substeps * scheme.dt
        lanes, count, size = controls.shape
        changes = dt * np.concatenate([np.zeros((lanes, 1, size)), controls], axis=1)
        movers = starts[:, None, :size] + np.cumsum(changes, axis=1)
        paths = np.moveaxis(movers, 0, -1).reshape(count + 1, -1, 3, lanes)
        moving = np.moveaxis(controls, 0, -1).reshape(count, -1, 3, lanes)
        motion = self.motion(starts)
        told = []
        for first in range(0, count, BLOCK):
            block = paths[first : first + BLOCK + 1]
            velocity = moving[first : first + BLOCK]
            positions, velocities = self.scene.play(motion, block, dt, substeps)
            motion = Motion(positions[-1], velocities[-1])
            told.append(self._told(positions, velocities, block[1:], velocity))
        latent = np.concatenate(told, axis=1)
        return np.concatenate([movers[:, 1:], controls, latent], axis=2)

    def _told(
        self,
        positions: Float[np.ndarray, "F N 3 L"],
        velocities: Float[np.ndarray, "F N 3 L"],
        movers: Float[np.ndarray, "F M 3 L"],
        moving: Float[np.ndarray, "F M 3 L"],
    ) -> Float[np.ndarray, "L F R"]:
        """Return the amplitudes and rates of nodes."""
        anchor = self.scene.anchor
        away = positions - anchor_of(anchor, movers)[:, None] - self.shapes.mean[..., None]
        relative = velocities - anchor_of(anchor, moving)[:, None]
        parts = [np.moveaxis(part, -1, 0) for part in (away, relative)]
        return np.concatenate([self.shapes.project(part) for part in parts], axis=-1)

    def has_diverged(self, states: Float[np.ndarray, "B T S"]) -> Bool[np.ndarray, " B"]:
        amplitudes = states[..., self.shapes.amplitudes]
        with np.errstate(invalid="ignore"):
            fits = np.abs(amplitudes) < MAX_AMPLITUDE * self.scene.size  # false for NaN too
        return np.asarray(~fits.all(axis=(1, 2)) | ~np.isfinite(states).all(axis=(1, 2)))

    def sample_starts(self, rng: np.random.Generator, count: int) -> Float[np.ndarray, "B S"]:
        chosen = rng.integers(0, len(self.starts), count)
        chosen[rng.random(count) < REST_SHARE] = 0
        return self.starts[chosen]


def _shape(start: Float[np.ndarray, " 3"], along: Float[np.ndarray, " 3"], radius: float) -> Shape:
    """Return the sphere or capsule that is drawn of a collider."""
    length = float(np.linalg.norm(along))
    middle = tuple((start + along / 2).tolist())
    if length == 0:
        return Shape("sphere", (radius,), middle, (1.0, 0.0, 0.0, 0.0), COLOUR)
    turn = np.empty(4)
    mujoco.mju_quatZ2Vec(turn, along)
    return Shape("capsule", (radius, length / 2), middle, tuple(turn.tolist()), COLOUR)


def _spread_nodes(positions: Float[np.ndarray, "N 3"], count: int, apart: float) -> tuple[int, ...]:
    """Return `count` nodes far from each other, each the farthest from those before it; fewer if they lie `apart` [m]."""
    chosen = [0]
    distance = np.linalg.norm(positions - positions[0], axis=1)
    while len(chosen) < min(count, len(positions)) and distance.max() > apart:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(positions - positions[chosen[-1]], axis=1))
    return tuple(sorted(chosen))
