"""A soft body and its movers: a definition and a mesh, prepared for the physics."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.definitions.soft import SoftDefinition
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.files.names import check_known
from neuroanimator.physics.soft.mesh import Mesh
from neuroanimator.physics.soft.meshes import cloth_body, solid_body
from neuroanimator.physics.soft.mirror import mirror_of
from neuroanimator.physics.soft.program import LANES, MuscleMotion, SoftProgram
from neuroanimator.physics.soft.soft_body import (
    Air,
    MovingPlane,
    Played,
    SoftBody,
)
from neuroanimator.physics.soft.soft_scene import Motion, Parameters, Paths, SoftScene
from neuroanimator.physics.state_parts import gait_of, parameter_from_table
from neuroanimator.physics.water import Water
from neuroanimator.state.parameters import Parameter
from neuroanimator.state.shape_contacts import FREE, BoxCollider, RoundCollider
from neuroanimator.systems.movers import Motions, Movers

WIND = ("air/wind_x", "air/wind_y", "air/wind_z")
"""Targets of parameters: the air's velocity along each axis [m/s]."""

WITHIN = 1e-3
"""Depth in a collider at which a node counts as inside, over the size of the body."""


class Scene(SoftScene):
    """A soft body of springs among M movers, the first of which that holds it is its anchor."""

    integrator = "xpbd"
    """Name of extended position-based dynamics in small steps."""
    lanes = LANES
    runs = LANES

    def __init__(self, definition: SoftDefinition, mesh: Mesh, motions: Motions | None = None):
        """Movers follow the `motions` in random runs. Raises ArgumentError for an invalid mesh, pin or collider."""
        self.definition = definition
        self.movers = Movers(definition.movers, motions)
        holding = [number for number, mover in enumerate(self.movers.tables) if mover.pins]
        if not holding and not definition.is_solid and definition.muscles is None:
            raise ArgumentError(
                "movers: nothing holds the cloth, and free flight is not emulated. Give a mover pins."
            )
        self.anchor = holding[0] if holding else FREE
        if self.anchor == FREE and definition.ground is None and definition.water is None:
            raise ArgumentError(
                "movers: nothing holds the body, and it falls forever. Add a [ground] or [water], or give a mover pins."
            )
        self._refuse_mixture()
        self.mesh = mesh
        # Float32 loses small pushes far from the origin, and with their balance a swimmer at rest creeps: millimetres a second.
        self.precision = np.float64 if definition.muscles else np.float32
        self.body = self._body(mesh)
        _refuse_loose_pieces(mesh, self.body.pins)
        self.finding_step = definition.physics.truth_step
        self.positions = self.body.positions
        self.faces = self.body.faces
        self.masses = self.body.masses
        self.margin = self.body.margin
        self.capsules = tuple(
            one._replace(radius=one.radius + self.margin) for one in self.body.capsules
        )
        self.boxes = tuple(one._replace(radius=self.margin) for one in self.body.boxes)
        self.has_ground = definition.ground is not None
        self.ground_height = None if definition.ground is None else definition.ground.height
        self.wind = self.body.air.wind
        self.parameters = tuple(self._parameters())
        self.water = self.body.water
        if self.water is not None and self.water.has_gravity and self.water.buoyancy < 1:
            buoyancy = self.water.buoyancy
            floating = buoyancy * definition.solid.density
            raise ArgumentError(
                f"water.buoyancy: with {buoyancy:g} the body is heavier than its water, and sinks. A density of {floating:.3g} "
                f"kg/m³ floats in it: set solid.density = {floating:.3g} and buoyancy = 1."
            )
        if definition.muscles is not None:
            self.muscles = tuple(definition.muscles.along)
            self.time_constant = self.body.time_constant
            self.mirror = mirror_of(mesh, definition.muscles.along)
        self.gait = gait_of(definition.gait, self.muscles)
        self.rest_height = definition.rest_height
        self.sampling = definition.sampling
        self._refuse_overlap()

    def _refuse_mixture(self) -> None:
        """Raise ArgumentError for muscles or water where they are not supported."""
        definition = self.definition
        if definition.muscles is None and definition.water is None and not definition.movers:
            raise ArgumentError("movers: wanted at least one, or [muscles].")
        if definition.muscles is None and definition.water is None:
            if definition.rest_height or definition.gait:
                raise ArgumentError(
                    "rest_height and gait: these are for bodies with [muscles]. Leave them out."
                )
            return
        if not definition.is_solid:
            raise ArgumentError(
                "muscles and water: wanted a solid, a Gmsh file of tetrahedra; this is a cloth."
            )
        if definition.muscles is None or definition.water is None:
            raise ArgumentError("muscles: wanted [water] with them, and muscles in the water.")
        if definition.movers or definition.ground is not None:
            raise ArgumentError(
                "muscles: a body with muscles swims freely, without movers and ground. Leave these out."
            )

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
        planes: tuple[MovingPlane, ...] = ()
        if definition.ground is not None:
            ground = definition.ground
            point = (0.0, 0.0, ground.height)
            planes = (MovingPlane(friction=ground.friction, mover=len(movers.tables), point=point),)
        capsules, boxes = self._colliders()
        water = None
        air = Air(**definition.air.model_dump())
        if definition.water is not None:
            water = Water(**definition.water.model_dump())
            air = Air(drag=0.0, density=0.0)
        surroundings = {
            "air": air,
            "capsules": tuple(capsules),
            "boxes": tuple(boxes),
            "planes": planes,
            "margin": definition.margin,
            "holders": holders,
            "held": held,
        }
        if definition.is_solid:
            return solid_body(
                mesh, definition.solid, pins, definition.muscles, water=water, **surroundings
            )
        return cloth_body(mesh, definition.cloth, pins, **surroundings)

    def _colliders(self) -> tuple[list[RoundCollider], list[BoxCollider]]:
        capsules = []
        boxes = []
        for number, mover in enumerate(self.movers.tables):
            for one in mover.colliders:
                if one.box is not None:
                    boxes.append(BoxCollider(number, one.start, one.box, friction=one.friction))
                elif one.radius is not None:
                    along = tuple(np.subtract(one.end or one.start, one.start).tolist())
                    capsules.append(
                        RoundCollider(number, one.start, along, one.radius, one.friction)
                    )
        return capsules, boxes

    def _parameters(self) -> list[Parameter]:
        parameters = []
        for name, table in self.definition.parameters.items():
            check_known([table.sets], WIND, "target", f"parameters.{name}.sets")
            own = self.wind[WIND.index(table.sets)]
            parameters.append(parameter_from_table(name, table, "m/s", own))
        if parameters and (self.anchor == FREE or self.movers.turning[self.anchor]):
            raise ArgumentError(
                "parameters: the wind can vary only if a mover that does not turn holds the body. Set its turns = false."
            )
        return parameters

    def _wind_at(self, parameters: Parameters) -> Float[np.ndarray, "3 ..."]:
        """Return the velocity of the air [m/s] for these values of the parameters."""
        wind = np.empty((3, *parameters.shape[1:]))
        for axis, speed in enumerate(self.wind):
            wind[axis] = speed
        tables = self.definition.parameters.values()
        for table, values in zip(tables, parameters, strict=True):
            wind[WIND.index(table.sets)] = values
        return wind

    def _refuse_overlap(self) -> None:
        """Raise ArgumentError, which names it, for a collider with nodes of the mesh in it."""
        body = self.body
        free = np.setdiff1d(np.arange(len(body.positions)), body.pins)
        owners = [self.movers.names[one.mover] for one in (*body.capsules, *body.boxes)]
        centre = self.centre(body.positions)
        contacts = self.contacts(body.positions - centre, tuple(free.tolist()))
        distances = contacts.distances(self.state_at_rest(centre))
        for number, distance in enumerate(distances):
            inside = free[distance < -body.margin - WITHIN * self.size]
            if len(inside) and number < len(owners):
                raise ArgumentError(
                    f"movers: {self.mesh.named_nodes(inside)} begin inside a collider of '{owners[number]}'. "
                    "Move it away, or make it smaller."
                )
            if len(inside):
                raise ArgumentError(
                    f"ground: {self.mesh.named_nodes(inside)} begin under it. Lower it."
                )

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
        those of each body, by default nominal; muscles are idle by default. See `SoftProgram.play`.
        """
        lanes = paths.shape[2] if paths.ndim > 2 else 1
        wind = None if parameters is None else self._wind_at(parameters)
        return SoftProgram(self.body, lanes, self.precision).play(
            motion.positions,
            motion.velocities,
            self.movers.poses(paths, motion.origin),
            duration,
            steps,
            wind,
            muscles,
            surface=self._surface_from(motion.origin),
        )

    def _surface_from(self, origin: Float[np.ndarray, " ..."]) -> Float[np.ndarray, " ..."] | None:
        """Return the height of the water's surface over the origin of each motion [m]; None without one."""
        if self.water is None or self.water.surface is None:
            return None
        return np.asarray(self.water.surface - (origin[2] if origin.ndim else 0.0))


def _refuse_loose_pieces(mesh: Mesh, pins: Int[np.ndarray, " K"]) -> None:
    """Raise BadFileError for pieces of a mesh that are not pinned beside another, and would fall away from it."""
    pieces = mesh.pieces()
    count = int(pieces.max()) + 1
    loose = np.setdiff1d(np.arange(count), pieces[pins])
    if count > 1 and len(loose):
        _, first = np.unique(pieces[mesh.elements[:, 0]], return_index=True)
        raise BadFileError(
            f"{mesh.name}: {len(loose)} of {count} pieces are held by nothing, those of the "
            f"{mesh.named_elements(first[loose])}. Join them to the rest, delete them, give a mover their nodes as pins, or "
            'leave all but the largest out: new --keep largest, which is keep = "largest" in the TOML file.'
        )
