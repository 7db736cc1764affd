"""Bodies of a scene as nodes, shapes, paints, skins and surfaces: the one walk over bones behind GLB and USD."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt16

from neuroanimator.animation.clip import Clip, together
from neuroanimator.appearance.colour import linear_of
from neuroanimator.appearance.mesh_skin import MeshSkin
from neuroanimator.appearance.part_names import colour_names
from neuroanimator.appearance.shapes import Shapes
from neuroanimator.appearance.skeleton import Bone, Shape, Skeleton
from neuroanimator.appearance.skin import Skin
from neuroanimator.appearance.skin_mesh import SkinMesh, colours_of, parts_of, skin_mesh
from neuroanimator.export.ghost import GHOST_RGBA
from neuroanimator.export.morphs import SurfaceNode, surface_nodes
from neuroanimator.state.rotation import continuous, rotation_matrices


class Paint(NamedTuple):
    """The look of a shape, or of a part of a skin."""

    name: str
    colour: tuple[float, ...] | None
    """Red, green and blue (sRGB) and opacity; None for a surface, and the wet part of a skin, whose points have colours."""
    is_thin: bool = False
    """Whether it has no inside, so that both sides are visible."""


GHOST = Paint("ghost", GHOST_RGBA)
"""The paint of a ghost's shapes and skin."""

THIN_GHOST = Paint("ghost cloth", GHOST_RGBA, is_thin=True)
"""The paint of a ghost's surface."""


class BoneNode(NamedTuple):
    """A bone, its motion in the frame of its parent, and its painted shapes."""

    bone: Bone
    positions: Float[np.ndarray, "F 3"]
    orientations: Float[np.ndarray, "F 4"]
    """Quaternions wxyz with continuous signs."""
    shapes: tuple[tuple[Shape, Paint], ...]


class SkinNode(NamedTuple):
    """A skin whose points follow joints: joint 0 is a root that no point follows, the others are the bones."""

    mesh: SkinMesh
    colours: Float[np.ndarray, "V 3"]
    """Linear colours of the points; all equal in a part whose paint has a colour."""
    joints: UInt16[np.ndarray, "V 4"]
    rest: Float[np.ndarray, "J 4 4"]
    """Poses of the joints in the bind pose, as column-vector matrices."""
    parts: dict[Paint, Int[np.ndarray, " _"]]
    """Numbers of the triangles of each part, by paint."""


@dataclass(frozen=True)
class SceneBody:
    """One clip in a scene."""

    clip: Clip
    title: str
    """Name of the whole body."""
    prefix: str
    """Prefix of the names of its parts; empty for the only body."""
    nodes: tuple[BoneNode, ...]
    """Its bones, each after its parent."""
    skin: SkinNode | None
    surface: SurfaceNode | None
    is_ghost: bool

    @property
    def surface_paint(self) -> Paint:
        """The paint of its surface."""
        shapes = self.clip.skeleton.shapes
        assert shapes is not None
        if self.is_ghost:
            return THIN_GHOST
        if shapes.shades is None:
            return Paint("cloth", shapes.rgba, is_thin=True)
        return Paint("flesh", None, is_thin=True)


def bodies_of(clips: Clip | Sequence[Clip], ghost: Clip | None) -> list[SceneBody]:
    """Return the bodies of a scene, the `ghost` last; only the first one has its scenery.

    Raises ArgumentError for clips that cannot be drawn together.
    """
    every = together(clips, ghost)
    surfaces = _surfaces(every if ghost is None else [*every, ghost])
    bodies = []
    for number, clip in enumerate(every, start=1):
        prefix = "" if len(every) == 1 else f"{clip.name} {number} "
        title = prefix.rstrip() or clip.name
        bodies.append(_body(clip, surfaces[number - 1], title, prefix, has_scenery=number == 1))
    if ghost is not None:
        bodies.append(_body(ghost, surfaces[-1], f"ghost {ghost.name}", "ghost ", is_ghost=True))
    return bodies


def _surfaces(clips: Sequence[Clip]) -> list[SurfaceNode | None]:
    """Return the surface of each clip, if it has one; the bodies of a school share their targets."""
    numbers: dict[Shapes, list[int]] = {}
    for number, clip in enumerate(clips):
        if clip.skeleton.shapes is not None:
            numbers.setdefault(clip.skeleton.shapes, []).append(number)
    surfaces: list[SurfaceNode | None] = [None] * len(clips)
    for shapes, alike in numbers.items():
        nodes = surface_nodes(shapes, [clips[number].states for number in alike])
        for number, node in zip(alike, nodes, strict=True):
            surfaces[number] = node
    return surfaces


def _body(
    clip: Clip,
    surface: SurfaceNode | None,
    title: str,
    prefix: str,
    *,
    has_scenery: bool = False,
    is_ghost: bool = False,
) -> SceneBody:
    skeleton = clip.skeleton
    names = colour_names(skeleton)
    positions, orientations = skeleton.local_poses(clip.states)
    orientations = continuous(orientations)
    nodes = []
    for number, bone in enumerate(skeleton.bones):
        shapes = []
        if has_scenery or skeleton.is_moved(number):
            for shape in bone.shapes:
                paint = GHOST if is_ghost else Paint(names[shape.colour], shape.colour)
                shapes.append((shape, paint))
        nodes.append(BoneNode(bone, positions[:, number], orientations[:, number], tuple(shapes)))
    skin = None if skeleton.skin is None else _skin(skeleton)
    return SceneBody(clip, title, prefix, tuple(nodes), skin, surface, is_ghost)


@lru_cache(maxsize=1)  # the bodies of a school have one skin
def _skin(skeleton: Skeleton) -> SkinNode:
    assert skeleton.skin is not None
    mesh = skin_mesh(skeleton)
    rest = np.tile(np.eye(4), (1 + len(skeleton.bones), 1, 1))
    rest[1:, :3, :3] = rotation_matrices(mesh.bind_orientations)
    rest[1:, :3, 3] = mesh.bind_positions
    parts = {}
    for name, triangles in parts_of(skeleton.skin, mesh).items():
        parts[_paint_of(skeleton.skin, name)] = triangles
    return SkinNode(
        mesh=mesh,
        colours=linear_of(colours_of(skeleton.skin, mesh.shades)),
        joints=np.where(mesh.weights > 0, mesh.bones + 1, 0).astype(np.uint16),
        rest=rest,
        parts=parts,
    )


def _paint_of(skin: Skin, name: str) -> Paint:
    """Return the paint of the part called `name`: a model's skin has one colour per part, other skins are wet."""
    if isinstance(skin, MeshSkin):
        for part in skin.parts:
            if part.name == name:
                return Paint(name, (*part.colour, 1.0))
    return Paint(name, None)
