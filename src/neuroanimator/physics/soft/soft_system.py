"""Soft bodies as a System: states hold movers and the amplitudes of shapes, the physics all nodes."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import mujoco
import numpy as np
from jaxtyping import Bool, Float

from neuroanimator.appearance.shapes import Shapes
from neuroanimator.appearance.skeleton import Bone, Shape, Skeleton
from neuroanimator.definitions.flex import FlexDefinition
from neuroanimator.definitions.soft import ColliderTable, MoverTable, SoftDefinition
from neuroanimator.files.names import refuse_twins
from neuroanimator.physics.rigid.bones import is_drawn, shape_of_geom
from neuroanimator.physics.schemes import schemes_of
from neuroanimator.physics.soft.find_shapes import RestingShapes
from neuroanimator.physics.soft.flex_model import geoms_below
from neuroanimator.physics.soft.flex_scene import FlexScene
from neuroanimator.physics.soft.mirror import odd_modes
from neuroanimator.physics.soft.own_frame import ManyPoints, seen_from_root, spin_of
from neuroanimator.physics.soft.scene import Scene
from neuroanimator.physics.soft.soft_scene import WORLD, Motion
from neuroanimator.physics.soft.throws import random_roots
from neuroanimator.state.layout import Bounds, Layout, Slice
from neuroanimator.state.links import Joint
from neuroanimator.state.parameters import nominal_values
from neuroanimator.state.rotation import NO_ROTATION, continuous
from neuroanimator.state.segments import (
    Constant,
    Driven,
    Lag,
    Plain,
    Position,
    Quaternion,
    Segment,
    Velocity,
)
from neuroanimator.state.shape_contacts import FREE, ROOT
from neuroanimator.state.structure import REVERSED_ABOUT, SoftSwimmer, Structure
from neuroanimator.systems.system import LONG_WINDOW, Scheme, System
from neuroanimator.terminal import inner_bar

BLOCK = 8
"""Number of super steps simulated at once: memory grows with it."""

FREE_BLOCK = 2
"""The same for bodies that are thrown: they fly away from an origin, and float32 is only precise near it."""

THROW_STEPS = 64
"""Number of super steps in a run of a free body, after which most are out of the movers' reach."""

SWIM_STEPS = 96
"""Number of super steps in a run of a body with muscles: it takes three seconds to come to its speed."""

SLICES = 11
"""Number of slices across a body near the surface of water, of each of which two nodes are probes."""

MAX_AMPLITUDE = 20.0
"""Amplitude, over the size of the body, at which a motion has diverged."""

COLOUR = (0.75, 0.75, 0.78, 1.0)
"""Colour of colliders."""

ROOT_SLICES = (
    Slice("position", 3, "m"),
    Slice("orientation", 4, "quaternion"),
    Slice("velocity", 3, "m/s"),
    Slice("angular_velocity", 3, "rad/s"),
)
"""Parts of the state of a free body's root, before its shapes."""


class SoftSystem(System):
    """A cloth or a solid; its state is `state.shape_contacts`': movers, their rates, a free root, shapes, their rates.

    Physics starts from nodes composed of the shapes, and then simulates all nodes; a state holds the part of their motion
    that the shapes can represent.
    """

    is_self_contained = False
    run_steps = 160
    window_steps = LONG_WINDOW

    def __init__(
        self,
        definition: SoftDefinition | FlexDefinition,
        scene: Scene | FlexScene,
        found: RestingShapes,
        definition_text: str = "",
    ):
        """`scene` is that of the definition, `definition_text` the text from which the system can be made again."""
        self.name = definition.name
        self.definition_text = definition_text
        self.scene = scene
        self.shapes = self._without_rigid_motion(found.shapes) if self.is_free else found.shapes
        self.rest = found.rest
        self.parameters = scene.parameters
        if scene.muscles:
            self.run_steps = SWIM_STEPS
            self.window_steps = System.window_steps
            self.warm_up = definition.sampling.warm_up
        elif self.is_free:
            self.run_steps = THROW_STEPS
        physics = definition.physics
        self.scheme, self.truth, self.fine = schemes_of(physics, scene.integrator)
        movers = self.scene.movers
        count = len(self.shapes.modes)
        self.state = Layout(
            (
                *movers.slices("pose"),
                *movers.slices("rate"),
                *(ROOT_SLICES if self.is_free else ()),
                Slice("shapes", count, "m"),
                Slice("shape_rates", count, "m/s"),
                *([Slice("activations", len(scene.muscles), "1")] if scene.muscles else []),
                *(parameter.slice for parameter in self.parameters),
            )
        )
        refuse_twins((part.name for part in self.state.slices), "movers and parameters")
        pulls = tuple(Slice(name, 1, "1") for name in scene.muscles)
        self.control = Layout((*movers.slices("control"), *pulls))
        count = len(pulls)
        self.bounds = Bounds((*-movers.speed, *[0.0] * count), (*movers.speed, *[1.0] * count))
        self.gait = scene.gait
        self.water_surface = None if scene.water is None else scene.water.surface
        self.structure = self._structure(definition.contact_nodes)
        self.skeleton = Skeleton(tuple(self._bones()), shapes=self.shapes)
        self.body_length = self.scene.size
        self.has_ground = scene.has_ground
        self.ground_height = scene.ground_height
        self.goals = self.goals_of(definition.goals)

    @property
    def activations(self) -> slice:
        """State entries of the muscles' activations."""
        first = self.shapes.first + 2 * len(self.shapes.modes)
        return slice(first, first + len(self.scene.muscles))

    @property
    def is_free(self) -> bool:
        """Whether nothing holds the body."""
        return self.scene.anchor == FREE

    def _without_rigid_motion(self, shapes: Shapes) -> Shapes:
        """Return the shapes without the shift and the turn of the whole body that rounded modes carry.

        Those belong to the root: a body put together with them would be taken apart into another state.
        """
        still = np.broadcast_to(shapes.mean, shapes.modes.shape)
        own = seen_from_root(still, shapes.modes, shapes.mean, self.scene.masses)
        return replace(shapes, modes=own.velocities)

    def _structure(self, contact_nodes: int) -> Structure:
        first = self.shapes.first
        movers = self.scene.movers
        count = len(self.shapes.modes)
        amplitudes = range(first, first + count)
        poses = Driven(size=movers.size, quaternions=movers.quaternions)
        segments: list[Segment] = [poses, Lag(size=movers.rate_size)]
        plain = range(first, first + 2 * count)
        if self.is_free:
            velocity = first - 6
            segments += [Position(rate=velocity), Quaternion(rate=velocity + 3), Velocity()]
            segments.append(Plain(size=3))
            plain = range(first - 3, first + 2 * count)
        segments.append(Plain(size=2 * count))
        if self.scene.muscles:
            return self._muscular_structure(segments[2:], tuple(plain))
        if self.parameters:
            constant = range(first + 2 * count, self.state.size)
            segments.append(Constant(size=len(constant)))
            plain = (*plain, *constant)
        surface = np.unique(self.shapes.faces)
        spread = _spread_nodes(self.shapes.mean[surface], contact_nodes, self.scene.margin)
        nodes = tuple(surface[list(spread)].tolist())
        return Structure(
            angles=(),
            rates=tuple((entry, entry + count) for entry in amplitudes),
            plain=tuple(plain),
            segments=tuple(segments),
            has_gravity=self.is_free,
            shape_contacts=self.scene.contacts(self.shapes.mean, nodes, self.shapes.modes),
        )

    def _muscular_structure(self, segments: list[Segment], plain: tuple[int, ...]) -> Structure:
        """Return the structure of a free body with muscles, which touches nothing; its last segment is that of activations."""
        scene = self.scene
        assert isinstance(scene, Scene)
        assert scene.water is not None
        modes = self.shapes.modes
        muscles = Lag(size=len(scene.muscles), time_constant=scene.time_constant)
        odd: tuple[bool, ...] = ()
        if scene.mirror is not None:
            odd = (*REVERSED_ABOUT, *2 * odd_modes(modes, scene.mirror))
        away = self.shapes.mean - self.shapes.mean.mean(axis=0)
        gyration = float(np.sqrt((away**2).sum(axis=1).mean()))
        probes = self._probes()
        displaced = np.moveaxis(modes[:, probes], 2, 0).tolist() if probes else []
        return Structure(
            angles=(),
            rates=(),
            plain=(*plain, *range(self.activations.start, self.activations.stop)),
            segments=(*segments, muscles),
            probes=tuple((*place, 0.0) for place in self.shapes.mean[probes].tolist()),
            probe_modes=tuple(tuple(map(tuple, axis)) for axis in displaced),
            has_gravity=scene.water.has_gravity,
            is_immersed=self.water_surface is not None,
            mirror=scene.mirror,
            swimmer=SoftSwimmer(gyration=gyration, odd=odd),
        )

    def _probes(self) -> list[int]:
        """Return the nodes whose height over the water matters: the highest and the lowest of each slice across the body.

        With a mirror they lie in its plane, so that it leaves them where they are.
        """
        scene = self.scene
        if self.water_surface is None:
            return []
        nodes = np.arange(len(scene.positions))
        if scene.mirror is not None:
            nodes = nodes[np.array(scene.mirror.points) == nodes]
        along, heights = scene.positions[nodes][:, [0, 2]].T
        slices = np.floor(SLICES * (along - along.min()) / np.ptp(along)).clip(max=SLICES - 1)
        probes: set[int] = set()
        for number in np.unique(slices):
            alike = nodes[slices == number]
            of_slice = heights[slices == number]
            probes |= {int(alike[of_slice.argmax()]), int(alike[of_slice.argmin()])}
        return sorted(probes)

    def _bones(self) -> list[Bone]:
        bones = []
        if isinstance(self.scene, FlexScene):
            bones += scenery(self.scene.model, self.scene.data)
        movers = self.scene.movers
        if self.scene.muscles:
            root = Joint("free", self.shapes.first - ROOT, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
            bones.append(Bone("body", -1, (0.0, 0.0, 0.0), NO_ROTATION, (root,), ()))
        for number, (name, mover, place) in enumerate(
            zip(movers.names, movers.tables, movers.places, strict=True)
        ):
            axes = np.eye(3).tolist()
            joints = [
                Joint("slide", place.entry + axis, tuple(axes[axis]), (0.0, 0.0, 0.0))
                for axis in range(3)
            ]
            if place.turns_freely:
                joints = [Joint("free", place.entry, tuple(axes[2]), (0.0, 0.0, 0.0))]
            elif place.turns:
                joints.append(Joint("hinge", place.entry + 3, tuple(axes[2]), (0.0, 0.0, 0.0)))
            shapes = self._drawn(number, mover)
            bones.append(Bone(name, -1, (0.0, 0.0, 0.0), NO_ROTATION, tuple(joints), shapes))
        return bones

    def _drawn(self, number: int, mover: MoverTable) -> tuple[Shape, ...]:
        """Return the shapes drawn for a mover: its geoms, or its colliders."""
        scene = self.scene
        if isinstance(scene, FlexScene):
            return shapes_below(scene.model, scene.data, scene.bodies[number])
        return tuple(_shape(collider) for collider in mover.colliders)

    def motion(self, states: Float[np.ndarray, "L S"]) -> Motion:
        """Return the nodes of states, side by side: (N, 3, L) each, relative to their own frames' origins."""
        movers = self.scene.movers
        first = self.shapes.first
        placement = self.shapes.placement
        local = self.shapes.unplaced(states)
        count = len(self.shapes.modes)
        rates = states[:, first + count : first + 2 * count]
        velocities = np.tensordot(rates, self.shapes.modes, axes=1)
        spin = np.zeros((len(states), 1, 3))
        velocity = np.zeros((len(states), 3))
        if self.is_free:
            velocity = states[:, first - 6 : first - 3]
            spin[:, 0] = states[:, first - 3 : first]
        elif placement.position >= 0:
            rates = states[:, movers.size :][:, movers.places[self.scene.anchor].rates]
            velocity = rates[:, :3]
            spin[:, 0] = spin_of(rates)
        local_velocities = velocities + np.cross(spin, local)
        velocities = placement.turned(states, local_velocities) + velocity[:, None]
        positions = np.moveaxis(placement.turned(states, local), 0, -1)
        return Motion(positions, np.moveaxis(velocities, 0, -1), placement.origin(states).T)

    def encode(
        self,
        positions: ManyPoints,
        velocities: ManyPoints,
        movers: Float[np.ndarray, "*B D"],
        rates: Float[np.ndarray, "*B R"],
        origin: Float[np.ndarray, " ..."] = WORLD,
        parameters: Float[np.ndarray, "*#B Q"] | None = None,
        activations: Float[np.ndarray, "*B M"] | None = None,
    ) -> Float[np.ndarray, "*B S"]:
        """Return the states closest to the motion of all nodes; `positions` are relative to `origin` [m].

        Parameters are nominal by default, and muscles idle.
        """
        mean = self.shapes.mean
        own = self.scene.own_motion(positions, velocities, movers, rates, mean, origin)
        amplitudes = self.shapes.project(own.positions - mean.astype(own.positions.dtype))
        changes = self.shapes.project(own.velocities)
        if parameters is None:
            parameters = nominal_values(self.parameters)
        held = np.broadcast_to(parameters, (*movers.shape[:-1], parameters.shape[-1]))
        if activations is None:
            activations = np.zeros((*movers.shape[:-1], len(self.scene.muscles)))
        parts = [movers, rates, own.root, amplitudes, changes, activations, held]
        return np.concatenate(parts, axis=-1)

    def _simulate(
        self,
        states: Float[np.ndarray, "B _ S"],
        controls: Float[np.ndarray, "B T C"],
        scheme: Scheme,
        substeps: int,
        threads: int,
    ) -> None:
        lanes = self.scene.lanes if len(states) > 1 else 1
        groups = [
            np.arange(first, first + lanes).clip(max=len(states) - 1)
            for first in range(0, len(states), lanes)
        ]

        def run(rows: np.ndarray) -> None:
            states[rows, 1:] = self._run(states[rows, 0], controls[rows], scheme, substeps)

        with inner_bar("runs", len(states)) as bar, ThreadPoolExecutor(threads) as pool:
            for done, _ in enumerate(pool.map(run, groups), start=1):
                bar.advance_to(min(done * lanes, len(states)))

    def _run(
        self,
        starts: Float[np.ndarray, "L S"],
        controls: Float[np.ndarray, "L T C"],
        scheme: Scheme,
        substeps: int,
    ) -> Float[np.ndarray, "L T S"]:
        """Return the states after each control."""
        dt = substeps * scheme.dt
        count = controls.shape[1]
        driven_by = self.scene.movers
        muscles = controls[..., driven_by.rate_size :]
        active = starts[:, self.activations]
        controls = controls[..., : driven_by.rate_size]
        movers = driven_by.paths(starts[:, : driven_by.size], controls, dt)
        paths = np.moveaxis(movers, 0, -1)
        motion = self.motion(starts)
        parameters = starts[:, self.parameter_entries]
        block_size = FREE_BLOCK if self.is_free and not self.scene.muscles else BLOCK
        told = []
        for first in range(0, count, block_size):
            block = paths[first : first + block_size + 1]
            driven = muscles[:, first : first + block_size]
            pulls, followed = self.scene.contracted(active, driven, dt)
            active = followed[:, -1]
            played = self.scene.play(motion, block, dt, substeps, parameters.T, pulls)
            positions, velocities = (np.moveaxis(part, -1, 0) for part in played)
            moved = movers[:, first + 1 : first + block_size + 1]
            rates = controls[:, first : first + block_size]
            origin = motion.origin.T[:, None]
            told.append(
                self.encode(
                    positions, velocities, moved, rates, origin, parameters[:, None], followed
                )
            )
            motion = Motion(played[0][-1], played[1][-1], motion.origin).recentred()
        states = np.concatenate(told, axis=1)
        if self.is_free:
            entries = slice(self.shapes.first - 10, self.shapes.first - 6)
            turned = np.swapaxes(states[..., entries], 0, 1)
            states[..., entries] = np.swapaxes(continuous(turned, starts[None, :, entries]), 0, 1)
        return states

    def has_diverged(self, states: Float[np.ndarray, "B T S"]) -> Bool[np.ndarray, " B"]:
        amplitudes = states[..., self.shapes.amplitudes]
        with np.errstate(invalid="ignore"):
            fits = np.abs(amplitudes) < MAX_AMPLITUDE * self.scene.size  # False for NaN
        return np.asarray(~fits.all(axis=(1, 2)) | ~np.isfinite(states).all(axis=(1, 2)))

    def sample_starts(self, rng: np.random.Generator, count: int) -> Float[np.ndarray, "B S"]:
        """Return undeformed states: at rest, or of a thrown free body. Parameters are random.

        Nodes composed of shapes would spring apart at first, and teach that.
        """
        starts = np.repeat(self.rest[None], count, axis=0)
        self.draw_bodies(rng, starts)
        if not self.is_free:
            return starts
        entries = slice(self.shapes.first - ROOT, self.shapes.first)
        centre = self.rest[entries][:3]
        movers = starts[:, : self.scene.movers.size]
        roots = random_roots(self.scene, rng, self.shapes.mean, centre, movers)
        for start, root in zip(starts, roots, strict=True):
            if root is not None:
                start[entries] = root
        return starts

    def sample_paths(
        self,
        rng: np.random.Generator,
        count: int,
        steps: int,
        dt: float,
        starts: Float[np.ndarray, "B S"] | None = None,
    ) -> Float[np.ndarray, "B T C"]:
        """Return controls of `count` runs, each along smooth paths of its movers about their rest; see `Movers.random_paths`.

        They begin at the `starts`, by default at rest, and return from there.
        """
        if self.scene.muscles:
            return self.scene.random_controls(rng, count, steps, dt)
        if starts is None:
            starts = np.repeat(self.rest[None], count, axis=0)
        return self.scene.random_paths(rng, *self.scene.movers.of(starts), steps, dt)


def _shape(collider: ColliderTable) -> Shape:
    """Return the box, sphere or capsule drawn for a collider."""
    if collider.radius is None:
        assert collider.box is not None
        return Shape("box", collider.box, collider.start, NO_ROTATION, COLOUR)
    along = np.subtract(collider.end or collider.start, collider.start)
    length = float(np.linalg.norm(along))
    if length == 0:
        return Shape("sphere", (collider.radius,), collider.start, NO_ROTATION, COLOUR)
    middle = tuple((np.array(collider.start) + along / 2).tolist())
    turned = np.empty(4)
    mujoco.mju_quatZ2Vec(turned, along)
    sizes = (collider.radius, length / 2)
    return Shape("capsule", sizes, middle, tuple(turned.tolist()), COLOUR)


def _spread_nodes(positions: Float[np.ndarray, "N 3"], count: int, apart: float) -> tuple[int, ...]:
    """Return `count` nodes, each the farthest from those before it; fewer if they would lie within `apart` [m] of others."""
    chosen = [0]
    distance = np.linalg.norm(positions - positions[0], axis=1)
    while len(chosen) < min(count, len(positions)) and distance.max() > apart:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(positions - positions[chosen[-1]], axis=1))
    return tuple(sorted(chosen))


def scenery(model: mujoco.MjModel, data: mujoco.MjData) -> list[Bone]:
    """Return the bone of the world, if any part of it is drawn."""
    shapes = shapes_below(model, data, 0)
    if not shapes:
        return []
    return [Bone("world", -1, (0.0, 0.0, 0.0), NO_ROTATION, (), shapes)]


def shapes_below(model: mujoco.MjModel, data: mujoco.MjData, root: int) -> tuple[Shape, ...]:
    """Return the shapes of a mocap body, or of the world for 0, along the world's axes, in the pose of rest in `data`."""
    shapes = []
    for geom in geoms_below(model, root):
        if not is_drawn(model, geom):
            continue
        shape = shape_of_geom(model, geom)
        body = int(model.geom_bodyid[geom])
        axes = np.reshape(data.xmat[body], (3, 3))
        position = data.xpos[body] + axes @ shape.position - data.xpos[root]
        orientation = np.empty(4)
        mujoco.mju_mulQuat(orientation, data.xquat[body], np.array(shape.orientation))
        shapes.append(
            replace(
                shape,
                position=tuple(position.tolist()),
                orientation=tuple(orientation.tolist()),
            )
        )
    return tuple(shapes)
