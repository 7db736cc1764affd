"""Throw a jelly into a bin by the path of the plate it lies on.

A throw is a swing of the plate, after which it drops away. From then on the centre of mass flies along a parabola, whatever the
jelly does about it: so what is asked of the emulator is position and velocity at release, and the chaos of a tumbling body is
none of its business. It learns random swings from rest. A throw is judged on the true physics with the bin in it: at the
end all nodes must lie within its walls.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import equinox as eqx
import numpy as np
from jaxtyping import Float
from soft_meshes import grid_tetrahedra, jelly, msh_text, outward

import neuroanimator as na
from neuroanimator.control.descent.parametrisation import Spline
from neuroanimator.control.objective.costs import NearTerm
from neuroanimator.control.objective.objective import Moments, Objective
from neuroanimator.data.config import DatasetConfig
from neuroanimator.data.generate import simulate_transitions
from neuroanimator.data.store import Transitions
from neuroanimator.definitions.soft import ColliderTable, MoverTable, SoftDefinition
from neuroanimator.emulator.arrays import as_parameter
from neuroanimator.files.tables import check_table, read_toml
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.pose import read_pose
from neuroanimator.state.structure import Structure
from neuroanimator.systems.loading import resolve
from neuroanimator.systems.soft.mesh import Mesh
from neuroanimator.systems.soft.scene import Scene
from neuroanimator.systems.soft.soft_body import GRAVITY
from neuroanimator.systems.soft.soft_scene import Motion
from neuroanimator.systems.soft.soft_system import SoftSystem
from neuroanimator.systems.system import LONG_WINDOW, Runs
from neuroanimator.training.config import TrainingConfig

DEFINITION = Path(__file__).with_name("throw.toml")

LAYERS, SIDE = 8, 7
"""Nodes of the jelly up, and along each side of a layer: 392 in all."""

STEPS = 24
"""Super steps of a swing: 0.8 s."""

DROP = (0.0, 0.0, -2.0)
"""Velocity at which the plate then drops away [m/s]."""

DROPPING = 3
"""Number of super steps for which it does."""

FALLING = 45
"""Number of super steps after the swing, in which the jelly flies, and comes to rest."""

KNOTS = 6
"""Number of knots of the splines of each control."""

RIM = -0.1
"""Height of the bin's rim [m]; it stands on the ground, 0.25 m below."""

WIDTH = 1.5
"""Width of the bin [the jelly's size]."""

AWAY = (0.5, 1.0)
"""Distance between the jelly at rest and the bin [the jelly's size]."""

ASIDE = 30.0
"""Largest angle between the direction of the bin and the x axis [degrees]."""

WALL = 0.01
"""Half the thickness of the bin's walls [m]."""

NEAR = 0.05
"""Distance from the middle of the rim that counts as an error of one [the jelly's size]."""

ROOM = ((-0.3, -0.25, -0.02), (0.04, 0.25, 0.3))
"""Least and largest displacement of the plate from its rest [m]: it stays clear of the bin."""

BEYOND = 0.1
"""Distance that the plate of a random swing may go beyond that [m]."""

WEIGHTLESS = -7.0
"""Acceleration of the plate upwards at which a random swing may let the jelly go [m/s²]."""

SWINGS = 640
"""Number of random swings that training begins with."""

SPREADS = (0.2, 1.0)
"""Least and largest spread of the numbers of their splines."""

WIDTHS = (128, 128)
BATCH = 512
UPDATES = 3_000

SEARCHED = 1_024
"""Number of random swings tried on the emulator for each bin."""

STARTS = 4
"""Number of the best of them that are descended from."""

WINDOW_STARTS = range(0, STEPS - LONG_WINDOW + 1, 2)
"""Super steps of a swing at which its windows begin."""


def system_in(folder: Path) -> SoftSystem:
    """Return the jelly on its plate, whose files are written into `folder`."""
    nodes = jelly(LAYERS, SIDE)
    tetrahedra = outward(nodes, grid_tetrahedra(LAYERS, SIDE))
    (folder / "jelly.msh").write_text(msh_text(nodes, tetrahedra))
    toml = folder / DEFINITION.name
    toml.write_text(DEFINITION.read_text())
    system = na.load_system(str(toml))
    assert isinstance(system, SoftSystem)
    return system


class Landing(NearTerm):
    """Fly to a point of the horizontal plane at the height of the rim: where the centre of mass comes down through it."""

    structure: Structure = eqx.field(static=True)

    def observe(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B 2"]:
        pose = read_pose(self.structure, state)
        xp = state.__array_namespace__()
        gravity = -GRAVITY[2]
        rising = pose.velocity[..., 2:]
        height = xp.maximum(pose.position[..., 2:] - RIM, 0.0)
        flight = (rising + xp.sqrt(rising**2 + 2 * gravity * height)) / gravity
        return pose.position[..., :2] + flight * pose.velocity[..., :2]


class Thrower:
    """A jelly on its plate, and throws of it from rest."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.system = system_in(folder)
        self.name, self.definition, self.substeps = resolve(str(folder / DEFINITION.name))
        self.dt = self.substeps * self.system.physics_dt
        self.parametrisation = Spline.of(STEPS, KNOTS, self.system.bounds)

    @property
    def size(self) -> float:
        """Size of the jelly [m]."""
        return self.system.scene.size

    def bin(self, rng: np.random.Generator) -> Float[np.ndarray, " 3"]:
        """Return the middle of a random bin's rim [m]."""
        distance = 0.5 + rng.uniform(*AWAY) + WIDTH / 2
        angle = np.radians(rng.uniform(-ASIDE, ASIDE))
        return np.array(
            [
                distance * self.size * np.cos(angle),
                distance * self.size * np.sin(angle),
                RIM,
            ]
        )

    def objective(self, target: Float[np.ndarray, " 3"]) -> Objective:
        """Return the cost of not flying to `target`, and of a plate that comes near the bin."""
        low, high = (self.system.rest[:3] + end for end in ROOM)
        return na.Objective.of(
            self.landing(target),
            na.stay_within(self.system, "paddle", low, high, within=0.005),
            na.effort(1e-2),
        )

    def landing(self, target: Float[np.ndarray, " 3"]) -> Landing:
        """Return the cost of not flying to `target`."""
        return Landing(
            weight=as_parameter(1.0),
            when=Moments.of(None, None),
            wanted=as_parameter(target[:2]),
            within=as_parameter(NEAR * self.size),
            structure=self.system.structure,
        )

    def landings(self, states: Float[np.ndarray, "B S"]) -> Float[np.ndarray, "B 2"]:
        """Return where jellies fly to [m] that are released in these states."""
        return np.asarray(self.landing(np.zeros(3)).observe(states))

    def controls(self, numbers: Float[np.ndarray, "B Z"]) -> Float[np.ndarray, "B T C"]:
        """Return the controls of splines."""
        return np.stack([np.asarray(self.parametrisation.controls(z), float) for z in numbers])

    def swings(self, rng: np.random.Generator) -> Float[np.ndarray, "B T C"]:
        """Return the controls of random swings, the plate of which hardly leaves its room, and carries the jelly."""
        low, high = (np.array(end) for end in ROOM)
        found = []
        while len(found) < SWINGS:
            numbers = rng.normal(scale=rng.uniform(*SPREADS), size=self.parametrisation.size)
            controls = self.controls(numbers[None])[0]
            moved = np.cumsum(self.dt * controls, axis=0)
            is_near = ((moved > low - BEYOND) & (moved < high + BEYOND)).all()
            if is_near and np.diff(controls[:, 2]).min() > WEIGHTLESS * self.dt:
                found.append(controls)
        return np.stack(found)

    def play(self, controls: Float[np.ndarray, "B T C"]) -> Runs:
        """Return the runs from rest on the true physics."""
        starts = np.repeat(self.system.rest[None], len(controls), axis=0)
        return self.system.simulate(starts, controls, self.dt, threads=2)

    def transitions(self, runs: Runs, controls: Float[np.ndarray, "B T C"]) -> Transitions:
        """Return windows of the runs."""
        config = DatasetConfig(
            system=self.name, definition=self.definition, substeps=self.substeps, count=12
        )
        whole = np.flatnonzero(~runs.has_diverged)
        states = []
        given = []
        for start in WINDOW_STARTS:
            states.append(runs.states[whole, start : start + LONG_WINDOW + 1])
            given.append(controls[whole, start : start + LONG_WINDOW])
        return replace(
            simulate_transitions(config),
            states=np.concatenate(states).astype(np.float32),
            controls=np.concatenate(given).astype(np.float32),
            run=np.tile(whole, len(WINDOW_STARTS)),
        )

    def emulator(self) -> na.Emulator:
        """Return the emulator that has learnt random swings; found in the folder, or trained."""
        file = self.folder / "throw.emulator.safetensors"
        if file.exists():
            return na.load_emulator(file)
        controls = self.swings(np.random.default_rng(0))
        data = self.transitions(self.play(controls), controls)
        settings = TrainingConfig.usual(
            data.system.structure, widths=WIDTHS, batch=BATCH, updates=UPDATES
        )
        return na.train(data, settings, file)

    def with_bin(self, target: Float[np.ndarray, " 3"]) -> Scene:
        """Return the physics of the jelly, its plate, and a bin that stands there."""
        definition = check_table(read_toml(DEFINITION), DEFINITION.name, SoftDefinition)
        assert definition.ground is not None
        half = WIDTH * self.size / 2
        height = (RIM - definition.ground.height) / 2
        colliders = []
        for axis in range(2):
            for side in (-1, 1):
                sizes = [half + 2 * WALL, half + 2 * WALL, height]
                sizes[axis] = WALL
                middle = [0.0, 0.0, -height]
                middle[axis] = side * (half + WALL)
                colliders.append(ColliderTable(box=tuple(sizes), start=tuple(middle)))
        mover = MoverTable(position=tuple(target.tolist()), colliders=tuple(colliders))
        movers = {"bin": mover} | definition.movers
        mesh = Mesh(self.system.scene.positions, self.system.scene.mesh.elements)
        return Scene(definition.model_copy(update={"movers": movers}), mesh)

    def thrown(
        self, controls: Float[np.ndarray, "T C"], target: Float[np.ndarray, " 3"]
    ) -> tuple[Float[np.ndarray, "F N 3"], Float[np.ndarray, "F 3"]]:
        """Return the nodes [m] and the plate [m] after each super step of a throw at a bin, and of the fall into it."""
        dropping = np.tile(DROP, (DROPPING, 1))
        idle = np.zeros((FALLING - DROPPING, 3))
        changes = self.dt * np.concatenate([np.zeros((1, 3)), controls, dropping, idle])
        plate = self.system.rest[:3] + np.cumsum(changes, axis=0)
        paths = np.concatenate([np.tile(target, (len(plate), 1)), plate], axis=1)
        scene = self.with_bin(target)
        motion = Motion(*(part[..., 0] for part in self.system.motion(self.system.rest[None])))
        steps = self.system.truth.steps(self.dt)
        found = []
        for frame in range(len(paths) - 1):
            positions, velocities = scene.play(motion, paths[frame : frame + 2], self.dt, steps)
            found.append(positions[0] + motion.origin)
            motion = Motion(positions[0], velocities[0], motion.origin).recentred()
        return np.array(found), plate[1:]

    def is_in_bin(self, nodes: Float[np.ndarray, "N 3"], target: Float[np.ndarray, " 3"]) -> bool:
        """Return whether all nodes lie within the walls of the bin, and below its rim."""
        aside = np.abs(nodes - target)[:, :2]
        is_within = aside < WIDTH * self.size / 2 + WALL
        return bool(is_within.all() and (nodes[:, 2] < RIM).all())

    def clearance(self, plate: Float[np.ndarray, "F 3"], target: Float[np.ndarray, " 3"]) -> float:
        """Return the least distance between plate and bin, along x or z [m]; negative where they overlap."""
        half = np.array(self.system.scene.boxes[0].half)
        outer = WIDTH * self.size / 2 + 2 * WALL
        aside = target[0] - outer - (plate[:, 0] + half[0])
        above = plate[:, 2] - half[2] - target[2]
        return float(np.maximum(aside, above).min())
