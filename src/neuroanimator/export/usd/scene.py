"""Clips as a USD file: bones as transforms, or as the joints of a skin's skeleton (UsdSkel), Z up, metres.

    clip → Xform per bone with time samples → Mesh per shape        rigid bodies
    clip → SkelRoot with Skeleton, SkelAnimation and skinned Mesh   bodies with a skin

`.usda` is text and needs nothing; `.usdc` and `.usdz` are made of it by Pixar's own library, the extra `[usd]`.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from neuroanimator.animation.clip import Clip, together
from neuroanimator.animation.interpolate import continuous
from neuroanimator.appearance.colour import linear_of
from neuroanimator.appearance.part_names import colour_names, identifier
from neuroanimator.appearance.shape_mesh import shape_mesh
from neuroanimator.appearance.skeleton import Bone, Shape, Skeleton
from neuroanimator.appearance.skin_mesh import (
    INFLUENCES,
    PARTS,
    colours_of,
    part_numbers,
    skin_mesh,
)
from neuroanimator.errors import ResourceError
from neuroanimator.export.ghost import GHOST_COLOUR, GHOST_OPACITY
from neuroanimator.export.usd.prims import (
    Prim,
    animated,
    array,
    number,
    string,
    tokens,
    turn,
    vector,
)
from neuroanimator.state.rotation import rotation_matrices
from neuroanimator.storage.files import write_whole
from neuroanimator.storage.unfinished import temporary_folder

DRY_ROUGHNESS = 0.6
"""How rough the surfaces of simple shapes are."""

WET_ROUGHNESS = 0.45
"""How rough a skin is: less than dry things, since it is wet."""

BINARY = (".usdc", ".usdz")
"""What Pixar's library makes of the text."""

TEXT = "#usda 1.0"
"""What a file of text begins with."""


def write_usd(clips: Clip | Sequence[Clip], path: str | Path, *, ghost: Clip | None = None) -> None:
    """Write one clip, or several such as a school, to `path`: .usda, or .usdc and .usdz with the extra `[usd]`.

    The scenery is there once, that of the first. A `ghost` is another motion of the only clip's body at the same place
    and time, in one translucent colour. What each motion is of is in the custom data of its topmost prim.

    Raises ArgumentError for what cannot be drawn together, and ResourceError where the library is missing.
    """
    path = Path(path)
    content = usda_text(together(clips, ghost), ghost).encode("ascii")
    if path.suffix in BINARY:
        content = _converted(content, path.suffix)
    write_whole(path, content)


def usda_text(clips: Sequence[Clip], ghost: Clip | None = None) -> str:
    """Return the text of a USD file of `clips`; see `write_usd`."""
    taken: set[str] = set()
    stage = Prim("Xform", identifier("scene", taken), metadata=['kind = "group"'])
    for number_, clip in enumerate(clips):
        title = clip.name if len(clips) == 1 else f"{clip.name} {number_ + 1}"
        has_scenery = number_ == 0
        stage.children.append(_Body(clip, stage.name, has_scenery=has_scenery).prim(title, taken))
    if ghost is not None:
        body = _Body(ghost, stage.name, has_scenery=False, is_ghost=True)
        stage.children.append(body.prim(f"ghost {ghost.name}", taken))
    lines = [TEXT, *_stage_metadata(clips, stage.name), "", *stage.lines(), ""]
    return "\n".join(lines)


def _stage_metadata(clips: Sequence[Clip], default_prim: str) -> list[str]:
    last = max(len(clip.times) for clip in clips) - 1
    rate = number(clips[0].rate)
    program = string(f"NeuroAnimator {version('neuroanimator')}")
    return [
        "(",
        f'    defaultPrim = "{default_prim}"',
        f"    doc = {program}",
        "    metersPerUnit = 1",
        '    upAxis = "Z"',
        "    startTimeCode = 0",
        f"    endTimeCode = {last}",
        f"    timeCodesPerSecond = {rate}",
        f"    framesPerSecond = {rate}",
        ")",
    ]


class _Body:
    """One clip's prims."""

    def __init__(
        self, clip: Clip, parent: str, *, has_scenery: bool = True, is_ghost: bool = False
    ):
        self._clip = clip
        self._parent = parent
        self._has_scenery = has_scenery
        self._is_ghost = is_ghost
        self._materials: dict[Any, str] = {}
        self._colour_names = colour_names(clip.skeleton)
        self._looks = Prim("Scope", "materials")
        self._path = ""

    def prim(self, title: str, taken: set[str]) -> Prim:
        """Return the topmost prim of this clip, its name made of `title` and none of those `taken`."""
        name = identifier(title, taken)
        self._path = f"/{self._parent}/{name}"
        clip = self._clip
        kind = "Xform" if clip.skeleton.skin is None else "SkelRoot"
        root = Prim(kind, name, metadata=['kind = "component"', *_custom_data(clip)])
        positions, orientations = clip.skeleton.local_poses(clip.states)
        orientations = continuous(orientations)
        if clip.skeleton.skin is None:
            root.children = self._transforms(positions, orientations)
        else:
            root.children = self._skinned(positions, orientations)
        root.children.append(self._looks)
        return root

    def _transforms(
        self, positions: Float[np.ndarray, "F B 3"], orientations: Float[np.ndarray, "F B 4"]
    ) -> list[Prim]:
        """Return the prims of the topmost bones, those of others below them."""
        bones = self._clip.skeleton.bones
        top: list[Prim] = []
        # Beside the topmost bones is the scope of the materials.
        taken: dict[int, set[str]] = {-1: {self._looks.name}}
        prims: list[Prim] = []
        for index, bone in enumerate(bones):
            prim = Prim("Xform", identifier(bone.name, taken[bone.parent]))
            taken[index] = set()
            prim.metadata = [f"displayName = {string(bone.name)}"]
            prim.properties = _track(bone, positions[:, index], orientations[:, index])
            if self._has_scenery or self._clip.skeleton.is_moved(index):
                for shape in bone.shapes:
                    mesh_name = identifier(shape.kind, taken[index])
                    prim.children.append(self._shape(shape, mesh_name))
            prims.append(prim)
            siblings = top if bone.parent < 0 else prims[bone.parent].children
            siblings.append(prim)
        return top

    def _shape(self, shape: Shape, name: str) -> Prim:
        mesh = shape_mesh(shape)
        prim = _mesh_prim(name, mesh.points, mesh.normals, mesh.triangles)
        prim.metadata = ['prepend apiSchemas = ["MaterialBindingAPI"]']
        prim.properties.append(f"rel material:binding = <{self._painted(shape.colour)}>")
        return prim

    def _skinned(
        self, positions: Float[np.ndarray, "F B 3"], orientations: Float[np.ndarray, "F B 4"]
    ) -> list[Prim]:
        """Return a skeleton whose joints are the bones, its animation, and the mesh that follows it."""
        skeleton = self._clip.skeleton
        taken: set[str] = set()
        root = identifier("root", taken)
        # Unreal wants one bone above all others; no point follows it.
        joints = [root, *(f"{root}/{identifier(bone.name, taken)}" for bone in skeleton.bones)]
        with_root = np.zeros((len(positions), len(joints), 3))
        with_root[:, 1:] = positions
        turns = np.zeros((len(positions), len(joints), 4))
        turns[:, 0, 0] = 1
        turns[:, 1:] = orientations
        animation = Prim("SkelAnimation", "motion")
        animation.properties = [
            f"uniform token[] joints = {tokens(joints)}",
            *animated("float3[] translations", map(array, with_root)),
            *animated("quatf[] rotations", map(array, turns)),
            f"half3[] scales = {array(np.ones((len(joints), 3)))}",
        ]
        rest = _matrices(skeleton.bones)
        rig = Prim("Skeleton", "bones", metadata=['prepend apiSchemas = ["SkelBindingAPI"]'])
        rig.properties = [
            f"uniform token[] joints = {tokens(joints)}",
            f"uniform matrix4d[] bindTransforms = {rest}",
            f"uniform matrix4d[] restTransforms = {rest}",
            f"rel skel:animationSource = <{self._path}/motion>",
        ]
        return [rig, animation, self._skin(skeleton)]

    def _skin(self, skeleton: Skeleton) -> Prim:
        assert skeleton.skin is not None
        skin = skin_mesh(skeleton)
        colours = linear_of(colours_of(skeleton.skin, skin.shades))
        prim = _mesh_prim("skin", skin.points, skin.normals, skin.triangles)
        apis = ["SkelBindingAPI", "MaterialBindingAPI"]
        prim.metadata = [f"prepend apiSchemas = {tokens(apis)}"]
        weights = skin.weights.ravel()
        # The root is the first joint.
        bones = np.where(skin.weights > 0, skin.bones + 1, 0).ravel()
        of_points = f'elementSize = {INFLUENCES}; interpolation = "vertex"'
        prim.properties += [
            f'color3f[] primvars:displayColor = {array(colours)} (interpolation = "vertex")',
            f"int[] primvars:skel:jointIndices = {array(bones)} ({of_points})",
            f"float[] primvars:skel:jointWeights = {array(weights)} ({of_points})",
            "matrix4d primvars:skel:geomBindTransform = "
            "( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1) )",
            f"rel skel:skeleton = <{self._path}/bones>",
        ]
        if self._is_ghost:
            prim.properties.append(f"rel material:binding = <{self._ghost()}>")
            return prim
        prim.properties += ['uniform token subsetFamily:materialBind:familyType = "partition"']
        part_of = part_numbers(skeleton.skin, skin)
        for index, part in enumerate(PARTS):
            if (part_of == index).any():
                prim.children.append(self._subset(part, np.flatnonzero(part_of == index)))
        return prim

    def _subset(self, part: str, faces: np.ndarray) -> Prim:
        """Return the triangles of a part of the skin, which have a material of their own to be painted."""
        prim = Prim("GeomSubset", part, metadata=['prepend apiSchemas = ["MaterialBindingAPI"]'])
        prim.properties = [
            'uniform token elementType = "face"',
            'uniform token familyName = "materialBind"',
            f"int[] indices = {array(faces)}",
            f"rel material:binding = <{self._wet(part)}>",
        ]
        return prim

    def _painted(self, colour: tuple[float, ...]) -> str:
        if self._is_ghost:
            return self._ghost()
        light = linear_of(colour[:3])
        diffuse = f"color3f inputs:diffuseColor = {vector(light)}"
        return self._material(
            colour, self._colour_names[colour], [diffuse], DRY_ROUGHNESS, colour[3]
        )

    def _ghost(self) -> str:
        diffuse = f"color3f inputs:diffuseColor = {vector(linear_of(GHOST_COLOUR))}"
        return self._material("ghost", "ghost", [diffuse], DRY_ROUGHNESS, GHOST_OPACITY)

    def _wet(self, part: str) -> str:
        """Return the path of a part's material, whose colour is that of the mesh's points."""
        reader = Prim("Shader", "colours")
        reader.properties = [
            'uniform token info:id = "UsdPrimvarReader_float3"',
            'string inputs:varname = "displayColor"',
            "float3 outputs:result",
        ]
        source = f"{self._path}/materials/{part}/colours.outputs:result"
        diffuse = f"color3f inputs:diffuseColor.connect = <{source}>"
        return self._material(part, part, [diffuse], WET_ROUGHNESS, 1.0, [reader])

    def _material(
        self,
        key: Any,
        name: str,
        colour: list[str],
        roughness: float,
        opacity: float,
        others: Sequence[Prim] = (),
    ) -> str:
        """Return the path of the material known by `key`, made if there is none."""
        if key not in self._materials:
            taken = {child.name for child in self._looks.children}
            prim = Prim("Material", identifier(name, taken))
            path = f"{self._path}/{self._looks.name}/{prim.name}"
            shader = Prim("Shader", "surface")
            shader.properties = [
                'uniform token info:id = "UsdPreviewSurface"',
                *colour,
                "float inputs:metallic = 0",
                f"float inputs:roughness = {number(roughness)}",
                f"float inputs:opacity = {number(opacity)}",
                "token outputs:surface",
            ]
            prim.properties = [f"token outputs:surface.connect = <{path}/surface.outputs:surface>"]
            prim.children = [shader, *others]
            self._looks.children.append(prim)
            self._materials[key] = path
        return self._materials[key]


def _custom_data(clip: Clip) -> list[str]:
    """Return what a motion is of, for whoever opens the file."""
    rows = [
        f"    string system = {string(clip.name)}",
        f"    double seconds = {number(clip.times[-1])}",
    ]
    if clip.source:
        rows.append(f"    string source = {string(clip.source)}")
    return ["customData = {", *rows, "}"]


def _track(
    bone: Bone, positions: Float[np.ndarray, "F 3"], orientations: Float[np.ndarray, "F 4"]
) -> list[str]:
    """Return where a bone is in its parent's frame: at all times, or in every frame."""
    order = 'uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:orient"]'
    if not bone.is_moving:
        return [
            f"double3 xformOp:translate = {vector(positions[0])}",
            f"quatd xformOp:orient = {turn(orientations[0])}",
            order,
        ]
    return [
        *animated("double3 xformOp:translate", map(vector, positions)),
        *animated("quatd xformOp:orient", map(turn, orientations)),
        order,
    ]


def _mesh_prim(name: str, points: np.ndarray, normals: np.ndarray, triangles: np.ndarray) -> Prim:
    extent = np.stack([points.min(axis=0), points.max(axis=0)])
    prim = Prim("Mesh", name)
    prim.properties = [
        'uniform token subdivisionScheme = "none"',
        f"float3[] extent = {array(extent)}",
        f"int[] faceVertexCounts = {array(np.full(len(triangles), 3))}",
        f"int[] faceVertexIndices = {array(triangles.ravel())}",
        f"point3f[] points = {array(points)}",
        f'normal3f[] normals = {array(normals)} (interpolation = "vertex")',
    ]
    return prim


def _matrices(bones: Sequence[Bone]) -> str:
    """Return the transforms at rest of the root and the bones, of rows, which vectors are multiplied by from the left."""
    written = ["((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))"]
    for bone in bones:
        matrix = np.eye(4)
        matrix[:3, :3] = rotation_matrices(np.array(bone.orientation)).T
        matrix[3, :3] = bone.offset
        written.append(f"({', '.join(map(vector, matrix))})")
    return f"[{', '.join(written)}]"


def _converted(text: bytes, suffix: str) -> bytes:
    """Return the same scene as Pixar's library writes it."""
    try:
        from pxr import Sdf, UsdUtils  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise ResourceError(
            f"A {suffix} file is made by usd-core, which is missing. Install it with: pip install 'neuroanimator[usd]'; "
            "or write .usda, which needs nothing."
        ) from None
    with temporary_folder() as folder:
        source = folder / "scene.usda"
        source.write_bytes(text)
        layer = Sdf.Layer.FindOrOpen(str(source))
        crate = folder / "scene.usdc"
        layer.Export(str(crate))
        if suffix == ".usdc":
            return crate.read_bytes()
        package = folder / "scene.usdz"
        UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(crate)), str(package))
        return package.read_bytes()
