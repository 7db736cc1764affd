"""The drawn parts of a model with a soft body, apart from that: the geoms of its movers, and of the world."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from neuroanimator.appearance.binding import NO_ROTATION
from neuroanimator.appearance.skeleton import Bone, Shape
from neuroanimator.physics.rigid.bones import is_drawn, shape_of_geom
from neuroanimator.physics.soft.flex_model import geoms_below


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
