"""A MuJoCo soft body and its movers: a model with a flex, prepared for simulation.

Cloths and solids are drawn by their nodes. A rope has no surface: its nodes are followed by the edges of three crossing
ribbons, which lie r (a × t) to both sides of each node, with a the axes of the world and t along the rope.
Ribbons, too, are linear in the nodes, and at least two of them are wide for any direction of the rope.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float, Int

from neuroanimator.codegen.cores import core_count
from neuroanimator.definitions.flex import FlexDefinition
from neuroanimator.errors import ArgumentError
from neuroanimator.physics.rigid.warnings import warnings_counted
from neuroanimator.physics.soft.flex_model import (
    FlexBody,
    colliders_of,
    flex_body,
    ground_height,
    harden,
    is_pinned,
    mover_names,
    tied_bodies,
)
from neuroanimator.physics.soft.program import MuscleMotion
from neuroanimator.physics.soft.soft_body import Played, Points
from neuroanimator.physics.soft.soft_scene import Motion, Parameters, Paths, SoftScene
from neuroanimator.state.mover_poses import change_between
from neuroanimator.state.shape_contacts import FREE, HELD, BoxCollider, RoundCollider
from neuroanimator.systems.movers import mocap_movers
from neuroanimator.text import listed, quoted

SIDES = 6
"""Number of points drawn for each node of a rope: two edges of three ribbons."""


DrawnPoints = Float[np.ndarray, "P 3"]
"""Positions of what is drawn [m], or its velocities [m/s]."""


class Touching(NamedTuple):
    """Contacts of a flex with each of G geoms; zero for geoms that are not a mover's."""

    contacts: Int[np.ndarray, " G"]
    """Number of contacts."""
    depths: Float[np.ndarray, " G"]
    """Depth of the deepest contact [m]."""


class FlexScene(SoftScene):
    """A flex among M mocap bodies; the one that carries it is its anchor, if nothing pins it to the world."""

    integrator = "mujoco"
    """Name of the model's own integrator."""
    lanes = 1
    runs = 6
    has_ground = False
    """False, as its planes are drawn as geoms."""
    wind = (0.0, 0.0, 0.0)
    """Zero, as a model's wind is the same everywhere and always."""

    def __init__(self, definition: FlexDefinition, main: str, model: mujoco.MjModel):
        """Raises BadFileError for what is not supported in the model in the file `main`, ArgumentError for other movers."""
        self.body = flex_body(main, model)
        self.model = model.__copy__()
        harden(self.model, definition.physics.contact_time)
        self.finding_step = definition.physics.step
        """The user's step, as the teacher's would be slow."""
        bodies = mover_names(model)
        if set(bodies) != set(definition.movers):
            raise ArgumentError(
                f"movers: wanted the mocap bodies of {main}, {listed(sorted(bodies))}; got "
                f"{listed([quoted(name) for name in definition.movers])}. Name the same ones."
            )
        self.bodies = [bodies[name] for name in definition.movers]
        """The mocap bodies of the movers."""
        self.data = mujoco.MjData(model)
        """The model at rest."""
        mujoco.mj_fwdPosition(model, self.data)
        self.movers = mocap_movers(definition.movers, self.data.xpos[self.bodies])
        self.anchor = self._anchor()
        self.margin = self.body.margin
        self.positions = self.drawn_points(self.body.positions)
        self.faces = self.body.faces
        self.masses = self.body.masses
        if len(self.body.pairs):
            self.faces = _ribbons(self.body)
            edges = np.repeat(self.body.masses, SIDES)
            self.masses = np.concatenate([self.body.masses, edges]) / (1 + SIDES)
        self.ground_height = ground_height(model, self.data)
        if self.anchor == FREE and self.ground_height is None:
            raise ArgumentError(
                f"{main}: nothing holds the soft body, and it falls forever. Add a horizontal plane, pin nodes, or tie some "
                "to a mocap body by an equality (connect)."
            )
        colliders = []
        for number, body in enumerate(self.bodies):
            colliders += colliders_of(model, self.data, body, number, self.margin)
        self.capsules = tuple(one for one in colliders if isinstance(one, RoundCollider))
        self.boxes = tuple(one for one in colliders if isinstance(one, BoxCollider))
        self._models: dict[float, mujoco.MjModel] = {}

    def _anchor(self) -> int:
        """Return the number of the mover that carries the flex, else `HELD` or `FREE`."""
        tied = tied_bodies(self.model)
        if is_pinned(self.model) or 0 in tied:
            return HELD
        for number, body in enumerate(self.bodies):
            if body in tied:
                return number
        return FREE

    def play(
        self,
        motion: Motion,
        paths: Paths,
        duration: float,
        steps: int,
        parameters: Parameters | None = None,
        muscles: MuscleMotion | None = None,
    ) -> Played:
        model = self._stepping(duration / steps)
        if paths.ndim == 2:
            with warnings_counted:
                return self._play(model, motion, paths, steps)
        lanes = range(paths.shape[2])

        def run(lane: int) -> tuple[np.ndarray, np.ndarray]:
            origin = motion.origin[..., lane] if motion.origin.ndim else motion.origin
            own = Motion(motion.positions[..., lane], motion.velocities[..., lane], origin)
            return self._play(model, own, paths[..., lane], steps)

        with warnings_counted, ThreadPoolExecutor(min(len(lanes), core_count())) as pool:
            played = list(pool.map(run, lanes))
        positions = np.stack([one for one, _ in played], axis=-1)
        velocities = np.stack([one for _, one in played], axis=-1)
        return positions, velocities

    def touching(self, positions: Points, movers: Float[np.ndarray, " D"]) -> Touching:
        """Return the contacts of a body with its nodes at `positions` with the geoms of the movers."""
        data = mujoco.MjData(self.model)
        data.qpos[:] = self.body.slides(self._nodes(positions))
        self.put_movers(data, movers)
        with warnings_counted:
            mujoco.mj_fwdPosition(self.model, data)
        geoms = data.contact.geom.max(axis=1)
        roots = self.model.body_rootid[self.model.geom_bodyid[geoms]]
        is_mover = (geoms >= 0) & np.isin(roots, self.bodies)
        geoms = geoms[is_mover]
        depths = np.zeros(self.model.ngeom)
        np.maximum.at(depths, geoms, -data.contact.dist[is_mover])
        return Touching(np.bincount(geoms, minlength=self.model.ngeom), depths)

    def _stepping(self, step: float) -> mujoco.MjModel:
        """Return the model with this timestep [s]."""
        model = self._models.get(step)
        if model is None:
            model = self.model.__copy__()
            model.opt.timestep = step
            self._models[step] = model
        return model

    def _play(
        self, model: mujoco.MjModel, motion: Motion, path: Float[np.ndarray, "F D"], steps: int
    ) -> Played:
        """Return the result of `play` for one body; NaN after it has diverged."""
        data = mujoco.MjData(model)
        data.qpos[:] = self.body.slides(self._nodes(motion.positions + motion.origin))
        data.qvel[:] = self.body.rates(self._nodes(motion.velocities))
        frames = len(path) - 1
        positions = np.full((frames, *self.positions.shape), np.nan)
        velocities = positions.copy()
        for frame in range(frames):
            if not np.isfinite(data.qpos).all():
                break
            change = change_between(path[frame], path[frame + 1], self.movers.quaternions)
            try:
                for step in range(steps):
                    self.put_movers(data, self.movers.moved(path[frame], step / steps * change))
                    mujoco.mj_step(model, data)
            except mujoco.FatalError:
                break  # MuJoCo raises it for an element without a position
            positions[frame] = self.drawn_points(self.body.placed(data.qpos)) - motion.origin
            velocities[frame] = self.drawn_points(self.body.moved(data.qvel))
        return positions, velocities

    def put_movers(self, data: mujoco.MjData, entries: Float[np.ndarray, " D"]) -> None:
        """Set the mocap bodies to the movers' poses."""
        for body, place in zip(self.bodies, self.movers.places, strict=True):
            number = self.model.body_mocapid[body]
            data.mocap_pos[number] = place.placement.origin(entries)
            turned = place.placement.quaternions(entries)
            if turned is not None:
                mujoco.mju_mulQuat(data.mocap_quat[number], turned, self.model.body_quat[body])

    def _nodes(self, points: DrawnPoints) -> Points:
        """Return the nodes among the drawn points, which begin with them."""
        return points[: len(self.body.positions)]

    def drawn_points(self, nodes: Points) -> DrawnPoints:
        """Return the points drawn for nodes, beginning with these; or the points' velocities for the nodes'."""
        if not len(self.body.pairs):
            return nodes
        return np.concatenate([nodes, _edge_points(self.body, nodes)])


def _edge_points(body: FlexBody, nodes: Points) -> DrawnPoints:
    """Return points of the edges of a rope's ribbons, those of each node together."""
    first, second = body.pairs.T
    lengths = np.linalg.norm(body.positions[second] - body.positions[first], axis=1)
    pieces = (nodes[second] - nodes[first]) / lengths[:, None]
    along = np.zeros_like(nodes)
    np.add.at(along, first, pieces)
    np.add.at(along, second, pieces)
    along /= np.maximum(np.bincount(body.pairs.ravel(), minlength=len(nodes)), 1)[:, None]
    across = body.margin * np.cross(np.eye(3)[None], along[:, None])
    edges = np.concatenate([across, -across], axis=1)
    return (nodes[:, None] + edges).reshape(-1, 3)


def _ribbons(body: FlexBody) -> Int[np.ndarray, "F 3"]:
    """Return the triangles of a rope's ribbons."""
    faces = []
    for side in range(SIDES // 2):
        left = len(body.positions) + SIDES * body.pairs + side
        right = left + SIDES // 2
        faces.append(np.stack([left[:, 0], right[:, 0], right[:, 1]], axis=1))
        faces.append(np.stack([left[:, 0], right[:, 1], left[:, 1]], axis=1))
    return np.concatenate(faces)
