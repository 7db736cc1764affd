"""The drawing process of `live`: a header, then states come in on stdin, and a picture goes out for each."""

from __future__ import annotations

import io
import json
import os
import sys
from typing import Protocol, runtime_checkable

import mujoco
import numpy as np
from jaxtyping import Float

from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.appearance.skin_mesh import skin_mesh
from neuroanimator.export.film.clip_bytes import use_files
from neuroanimator.export.film.live import HEADER_SIZE
from neuroanimator.export.film.skeleton_model import add_bone, add_skin
from neuroanimator.systems import carried_system
from neuroanimator.systems.loading import MissingPhysicsError
from neuroanimator.systems.rigid.mujoco_system import MujocoSystem
from neuroanimator.systems.system import System

FOLLOWING = 0.5
"""Share of the way to the body that the camera goes from picture to picture: steady, and never far behind."""

DISTANCE = 2.2
"""Distance of the camera, over the body's size."""

ELEVATION = -25.0
"""How far the camera looks up [deg]: down, since it is negative."""

AZIMUTH = 120.0
"""Where the camera looks [deg]: from ahead of the side of a body that points along X."""

FLOOR_DEPTH = 6.0
"""How far the floor lies under the body at rest, over its size; where the system has ground, the floor is that."""

HALF_WIDTH = 40.0
"""Half the width of the floor, over the body's size."""

NEW_START = 0.5
"""A body that is farther from where the camera looks than this share of its size has begun anew."""


@runtime_checkable
class View(Protocol):
    """What is drawn: a model, posed state by state."""

    model: mujoco.MjModel

    def pose(self, data: mujoco.MjData, state: Float[np.ndarray, " S"]) -> str | mujoco.MjvCamera:
        """Put everything where `state` says, and return the camera."""


class RigidView:
    """A system's own MuJoCo model."""

    def __init__(self, system: MujocoSystem):
        self.model = system.model
        names = [self.model.camera(number).name for number in range(self.model.ncam)]
        self._camera = "side" if "side" in names else tracking_camera(self.model)

    def pose(self, data: mujoco.MjData, state: Float[np.ndarray, " S"]) -> str | mujoco.MjvCamera:
        """Put the joints where they are; the model's camera, or one that goes with the first body."""
        data.qpos[:] = state[: self.model.nq]
        return self._camera


class SkeletonView:
    """Bones under a skin over a plain floor, and a camera that goes along."""

    def __init__(self, skeleton: Skeleton, rest: Float[np.ndarray, " S"], *, has_ground: bool):
        self._skeleton = skeleton
        self._lookat: Float[np.ndarray, " 3"] | None = None
        points = np.array([bone.offset for bone in skeleton.bones])
        mesh = None
        if skeleton.skin is not None:
            mesh = skin_mesh(skeleton)
            points = mesh.points
        self._size = float(np.linalg.norm(np.ptp(points, axis=0)))
        floor = 0.0
        if not has_ground:
            positions, _ = skeleton.world_poses(rest[None])
            floor = float(positions[..., 2].min()) - FLOOR_DEPTH * self._size
        spec = mujoco.MjSpec.from_string(_place_mjcf(self._size, floor))
        for number, bone in enumerate(skeleton.bones):
            add_bone(spec, f"bone{number}", bone)
        if mesh is not None:
            add_skin(spec, "", skeleton, mesh)
        self.model = spec.compile()

    def pose(self, data: mujoco.MjData, state: Float[np.ndarray, " S"]) -> mujoco.MjvCamera:
        """Put the bones where they are; the camera follows their middle."""
        positions, orientations = self._skeleton.world_poses(state[None])
        data.mocap_pos[:] = positions[0]
        data.mocap_quat[:] = orientations[0]
        self._lookat = self._next_lookat(positions[0].mean(axis=0))
        camera = mujoco.MjvCamera()
        camera.lookat[:] = self._lookat
        camera.azimuth = AZIMUTH
        camera.elevation = ELEVATION
        camera.distance = DISTANCE * self._size
        return camera

    def _next_lookat(self, middle: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
        """Return where the camera looks next, if the body's middle is at `middle` [m]."""
        if self._lookat is None:
            return middle
        offset = middle - self._lookat
        if np.linalg.norm(offset) >= NEW_START * self._size:
            # A body that is somewhere else altogether has begun anew: the camera goes there at once.
            return middle
        return self._lookat + FOLLOWING * offset


def tracking_camera(model: mujoco.MjModel) -> mujoco.MjvCamera:
    """Return a camera that goes with the first body."""
    camera = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(model, camera)
    camera.type = mujoco.mjtCamera.mjCAMERA_TRACKING
    camera.trackbodyid = min(1, model.nbody - 1)
    return camera


def view_of(system: System, skeleton: Skeleton) -> View:
    """Return what is drawn of `system`: rigid bodies as MuJoCo has them, others as their skeleton has them."""
    if isinstance(system, MujocoSystem):
        return RigidView(system)
    return SkeletonView(skeleton, system.rest, has_ground=system.has_ground)


def _view(name: str, definition: str, skeleton: Skeleton, rest: Float[np.ndarray, " S"]) -> View:
    """Return what is drawn of the system called `name`; of a model that is not at hand, its skeleton."""
    try:
        return view_of(carried_system(name, definition), skeleton)
    except MissingPhysicsError:
        return SkeletonView(skeleton, rest, has_ground=True)


def serve() -> None:
    """Draw until there are no more states."""
    source = sys.stdin.buffer
    sink = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    # Nothing else may get between the pictures.
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    header_size = int.from_bytes(source.read(HEADER_SIZE), "little")
    header = np.load(io.BytesIO(source.read(header_size)), allow_pickle=False)
    width, height, entries = (int(number) for number in header["size"])
    skeleton = Skeleton.from_json(json.loads(str(header["skeleton"])))
    use_files(header["files"])
    view = _view(str(header["system"]), str(header["definition"]), skeleton, header["rest"])
    data = mujoco.MjData(view.model)
    view.model.vis.global_.offwidth = width
    view.model.vis.global_.offheight = height
    state_size = np.dtype("<f8").itemsize * entries
    with mujoco.Renderer(view.model, height, width) as renderer:
        while len(raw := source.read(state_size)) == state_size:
            camera = view.pose(data, np.frombuffer(raw, "<f8"))
            mujoco.mj_forward(view.model, data)
            renderer.update_scene(data, camera=camera)
            sink.write(np.ascontiguousarray(renderer.render()).tobytes())
            sink.flush()


def _place_mjcf(size: float, floor: float) -> str:
    """Return the place without the body, as MJCF; `floor` is the floor's height [m]."""
    wide = HALF_WIDTH * size
    return f"""<mujoco>
      <statistic extent="{size:.6g}" center="0 0 0"/>
      <visual>
        <global fovy="40" offwidth="1920" offheight="1440"/>
        <map znear="0.02" zfar="150"/>
        <headlight ambient="0.5 0.52 0.54" diffuse="0.3 0.3 0.3" specular="0 0 0"/>
      </visual>
      <asset>
        <texture type="skybox" builtin="gradient" rgb1="0.36 0.66 0.8" rgb2="0.05 0.2 0.32" width="64" height="384"/>
        <texture name="floor" type="2d" builtin="checker" rgb1="0.62 0.63 0.56" rgb2="0.56 0.58 0.52" width="128"
          height="128"/>
        <material name="floor" texture="floor" texuniform="true" texrepeat="{0.5 / size:.6g} {0.5 / size:.6g}"/>
      </asset>
      <worldbody>
        <light directional="true" dir="-0.12 0.22 -1" pos="0 0 {10 * size:.6g}" diffuse="0.5 0.5 0.47"
          castshadow="false"/>
        <geom type="plane" pos="0 0 {floor:.6g}" size="{wide:.6g} {wide:.6g} 1" material="floor" contype="0"
          conaffinity="0"/>
      </worldbody>
    </mujoco>"""


if __name__ == "__main__":
    serve()
