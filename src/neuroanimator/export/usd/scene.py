"""Clips as a USD file: bones as transforms, or as the joints of a skin's skeleton (UsdSkel), Z up, metres.

    clip → Xform per bone with time samples → Mesh per shape        rigid bodies
    clip → SkelRoot with Skeleton, SkelAnimation and skinned Mesh   bodies with a skin
    clip → SkelRoot with BlendShapes and their animated weights     surfaces of soft bodies, beside their bones

`.usda` is text and needs nothing; `.usdc` and `.usdz` are made from it by Pixar's own library, the extra `[usd]`.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

import numpy as np
from jaxtyping import Float

from neuroanimator.animation.clip import Clip
from neuroanimator.appearance.colour import linear_of
from neuroanimator.appearance.part_names import identifier
from neuroanimator.appearance.shape_mesh import shape_mesh
from neuroanimator.appearance.skeleton import Shape
from neuroanimator.appearance.skin_mesh import INFLUENCES
from neuroanimator.errors import ResourceError
from neuroanimator.export.bodies import (
    GHOST,
    Paint,
    SceneBody,
    SkinNode,
    bodies_of,
)
from neuroanimator.export.morphs import SurfaceNode
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
from neuroanimator.files.atomic import write_whole
from neuroanimator.files.unfinished import temporary_folder
from neuroanimator.state.rotation import rotation_matrices

DRY_ROUGHNESS = 0.6
"""Roughness of the surfaces of simple shapes."""

WET_ROUGHNESS = 0.45
"""Roughness of a skin: lower than that of dry things, as it is wet."""

SURFACE = "surface"
"""Name of the prim of a soft body's surface."""

RIG = ("bones", "motion", "skin")
"""Names of the prims of a skin."""

BINARY = (".usdc", ".usdz")
"""Suffixes of the files that Pixar's library makes from the text."""

IDENTITY = "((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))"
"""Identity matrix."""

TEXT = "#usda 1.0"
"""First line of a text file."""


def write_usd(clips: Clip | Sequence[Clip], path: str | Path, *, ghost: Clip | None = None) -> None:
    """Write one clip, or several such as a school, to `path`: .usda, or .usdc and .usdz with the extra `[usd]`.

    Only the first one's scenery is written. A `ghost` is another motion of the only clip's body at the same place and
    time, in one translucent colour. The custom data of its topmost prim describe each motion.

    Raises ArgumentError for clips that cannot be drawn together, and ResourceError if the library is missing.
    """
    path = Path(path)
    content = usda_text(bodies_of(clips, ghost)).encode("ascii")
    if path.suffix in BINARY:
        content = _converted(content, path.suffix)
    write_whole(path, content)


def usda_text(bodies: Sequence[SceneBody]) -> str:
    """Return the text of a USD file of `bodies`."""
    taken: set[str] = set()
    stage = Prim("Xform", identifier("scene", taken), metadata=['kind = "group"'])
    for body in bodies:
        path = f"/{stage.name}/{identifier(body.title, taken)}"
        stage.children.append(_BodyWriter(body, path).prim())
    lines = [TEXT, *_stage_metadata(bodies, stage.name), "", *stage.lines(), ""]
    return "\n".join(lines)


def _stage_metadata(bodies: Sequence[SceneBody], default_prim: str) -> list[str]:
    last = max(len(body.clip.times) for body in bodies if not body.is_ghost) - 1
    rate = number(bodies[0].clip.rate)
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


class _BodyWriter:
    """The prims of one body, at a path."""

    def __init__(self, body: SceneBody, path: str):
        self._body = body
        self._path = path
        self._materials: dict[tuple[tuple[float, ...] | str, bool], str] = {}
        self._looks = Prim("Scope", "materials")

    def prim(self) -> Prim:
        """Return the topmost prim of the body."""
        body = self._body
        kind = "Xform" if body.skin is None else "SkelRoot"
        name = self._path.rpartition("/")[2]
        root = Prim(kind, name, metadata=['kind = "component"', *_custom_data(body.clip)])
        if body.skin is None:
            root.children = self._transforms()
            if body.surface is not None:
                root.children.append(self._surface(body.surface))
        else:
            root.children = [*self._rig(body.skin), self._skin(body.skin)]
            # Without it USD's cache of boxes keeps that of the first time asked for.
            root.properties = animated("float3[] extent", map(array, _boxes(body.clip, body.skin)))
            if any(node.shapes for node in body.nodes):
                root.children += self._transforms()
        root.children.append(self._looks)
        return root

    def _transforms(self) -> list[Prim]:
        """Return the prims of the topmost bones, those of others below them."""
        top: list[Prim] = []
        # Beside the topmost bones are the scope of the materials, the surface and the rig of a skin.
        taken: dict[int, set[str]] = {-1: {self._looks.name, SURFACE, *RIG}}
        prims: list[Prim] = []
        for index, node in enumerate(self._body.nodes):
            bone = node.bone
            prim = Prim("Xform", identifier(bone.name, taken[bone.parent]))
            taken[index] = set()
            prim.metadata = [f"displayName = {string(bone.name)}"]
            prim.properties = _track(node.positions, node.orientations, is_moving=bone.is_moving)
            for shape, paint in node.shapes:
                mesh_name = identifier(shape.kind, taken[index])
                prim.children.append(self._shape(shape, paint, mesh_name))
            prims.append(prim)
            siblings = top if bone.parent < 0 else prims[bone.parent].children
            siblings.append(prim)
        return top

    def _shape(self, shape: Shape, paint: Paint, name: str) -> Prim:
        mesh = shape_mesh(shape)
        prim = _mesh_prim(name, mesh.points, mesh.normals, mesh.triangles)
        prim.metadata = ['prepend apiSchemas = ["MaterialBindingAPI"]']
        prim.properties.append(f"rel material:binding = <{self._material(paint)}>")
        return prim

    def _rig(self, skin: SkinNode) -> list[Prim]:
        """Return a skeleton whose joints are the bones, and its animation."""
        nodes = self._body.nodes
        taken: set[str] = set()
        root = identifier("root", taken)
        # Unreal wants one bone above all others; no point follows it.
        joints = [root]
        for node in nodes:
            parent = joints[1 + node.bone.parent]
            joints.append(f"{parent}/{identifier(node.bone.name, taken)}")
        at_root = np.zeros_like(nodes[0].positions)
        not_turned = np.tile([1.0, 0.0, 0.0, 0.0], (len(at_root), 1))
        positions = np.stack([at_root, *(node.positions for node in nodes)], axis=1)
        orientations = np.stack([not_turned, *(node.orientations for node in nodes)], axis=1)
        animation = Prim("SkelAnimation", "motion")
        animation.properties = [
            f"uniform token[] joints = {tokens(joints)}",
            *animated("float3[] translations", map(array, positions)),
            *animated("quatf[] rotations", map(array, orientations)),
            f"half3[] scales = {array(np.ones((len(joints), 3)))}",
        ]
        rest = np.tile(np.eye(4), (len(joints), 1, 1))
        rest[1:, :3, :3] = rotation_matrices(np.array([node.bone.orientation for node in nodes]))
        rest[1:, :3, 3] = [node.bone.offset for node in nodes]
        return [_skeleton(joints, _matrices(skin.rest), _matrices(rest), self._path), animation]

    def _skin(self, skin: SkinNode) -> Prim:
        mesh = skin.mesh
        prim = _mesh_prim("skin", mesh.points, mesh.normals, mesh.triangles)
        apis = ["SkelBindingAPI", "MaterialBindingAPI"]
        prim.metadata = [f"prepend apiSchemas = {tokens(apis)}"]
        of_points = f'elementSize = {INFLUENCES}; interpolation = "vertex"'
        prim.properties += [
            _display_colours(skin.colours),
            f"int[] primvars:skel:jointIndices = {array(skin.joints.ravel())} ({of_points})",
            f"float[] primvars:skel:jointWeights = {array(mesh.weights.ravel())} ({of_points})",
            f"matrix4d primvars:skel:geomBindTransform = {IDENTITY}",
            f"rel skel:skeleton = <{self._path}/bones>",
        ]
        if self._body.is_ghost:
            prim.properties.append(f"rel material:binding = <{self._material(GHOST)}>")
            return prim
        prim.properties += ['uniform token subsetFamily:materialBind:familyType = "partition"']
        taken: set[str] = set()
        for paint, triangles in skin.parts.items():
            prim.children.append(self._subset(paint, identifier(paint.name, taken), triangles))
        return prim

    def _surface(self, surface: SurfaceNode) -> Prim:
        """Return a surface that moves with its anchor, and its shapes; renderers compute the normals of smooth surfaces."""
        path = f"{self._path}/{SURFACE}"
        morphs = surface.morphs
        names = [f"shape{number}" for number in range(1, len(morphs.moving) + 1)]
        root = Prim("SkelRoot", SURFACE)
        root.properties = _track(surface.positions, surface.orientations)
        rig = _skeleton(["root"], f"[{IDENTITY}]", f"[{IDENTITY}]", path)
        motion = Prim("SkelAnimation", "motion")
        weights = surface.weights[:, : len(names)]
        motion.properties = [
            'uniform token[] joints = ["root"]',
            "float3[] translations = [(0, 0, 0)]",
            "quatf[] rotations = [(1, 0, 0, 0)]",
            "half3[] scales = [(1, 1, 1)]",
            f"uniform token[] blendShapes = {tokens(names)}",
            *animated("float[] blendShapeWeights", map(array, weights)),
        ]
        mesh = _mesh_prim("mesh", morphs.points, None, morphs.triangles)
        mesh.metadata = ['prepend apiSchemas = ["SkelBindingAPI", "MaterialBindingAPI"]']
        targets = ", ".join(f"<{path}/mesh/{name}>" for name in names)
        paint = self._body.surface_paint
        of_all = '(elementSize = 1; interpolation = "constant")'
        mesh.properties += [
            "uniform bool doubleSided = true",
            f"int[] primvars:skel:jointIndices = [0] {of_all}",
            f"float[] primvars:skel:jointWeights = [1] {of_all}",
            f"matrix4d primvars:skel:geomBindTransform = {IDENTITY}",
            f"rel skel:skeleton = <{path}/bones>",
            f"uniform token[] skel:blendShapes = {tokens(names)}",
            f"rel skel:blendShapeTargets = [{targets}]",
            f"rel material:binding = <{self._material(paint)}>",
        ]
        if paint.colour is None:
            mesh.properties.append(_display_colours(morphs.colours))
        for name, target in zip(names, morphs.moving, strict=True):
            shape = Prim("BlendShape", name)
            offsets = array(morphs.scale * target.deltas)
            shape.properties = [f"uniform vector3f[] offsets = {offsets}"]
            mesh.children.append(shape)
        root.children = [rig, motion, mesh]
        return root

    def _subset(self, paint: Paint, name: str, faces: np.ndarray) -> Prim:
        """Return the triangles of a part of the skin, with a material of their own."""
        prim = Prim("GeomSubset", name, metadata=['prepend apiSchemas = ["MaterialBindingAPI"]'])
        prim.properties = [
            'uniform token elementType = "face"',
            'uniform token familyName = "materialBind"',
            f"int[] indices = {array(faces)}",
            f"rel material:binding = <{self._material(paint)}>",
        ]
        return prim

    def _material(self, paint: Paint) -> str:
        """Return the path of the material of `paint`, made if it is missing."""
        key = (paint.colour or paint.name, paint.is_thin)
        if key in self._materials:
            return self._materials[key]
        taken = {child.name for child in self._looks.children}
        prim = Prim("Material", identifier(paint.name, taken))
        path = f"{self._path}/{self._looks.name}/{prim.name}"
        shader = Prim("Shader", "surface")
        prim.children = [shader]
        if paint.colour is None:
            # Its colour is that of the mesh's points.
            reader = Prim("Shader", "colours")
            reader.properties = [
                'uniform token info:id = "UsdPrimvarReader_float3"',
                'string inputs:varname = "displayColor"',
                "float3 outputs:result",
            ]
            prim.children.append(reader)
            diffuse = f"color3f inputs:diffuseColor.connect = <{path}/colours.outputs:result>"
            roughness = WET_ROUGHNESS
            opacity = 1.0
        else:
            *colour, opacity = paint.colour
            diffuse = f"color3f inputs:diffuseColor = {vector(linear_of(colour))}"
            roughness = DRY_ROUGHNESS
        shader.properties = [
            'uniform token info:id = "UsdPreviewSurface"',
            diffuse,
            "float inputs:metallic = 0",
            f"float inputs:roughness = {number(roughness)}",
            f"float inputs:opacity = {number(opacity)}",
            "token outputs:surface",
        ]
        prim.properties = [f"token outputs:surface.connect = <{path}/surface.outputs:surface>"]
        self._looks.children.append(prim)
        self._materials[key] = path
        return path


def _custom_data(clip: Clip) -> list[str]:
    """Return the description of a motion, for readers of the file."""
    rows = [
        f"    string system = {string(clip.name)}",
        f"    double seconds = {number(clip.times[-1])}",
    ]
    if clip.source:
        rows.append(f"    string source = {string(clip.source)}")
    return ["customData = {", *rows, "}"]


def _track(
    positions: Float[np.ndarray, "F 3"],
    orientations: Float[np.ndarray, "F 4"] | None,
    *,
    is_moving: bool = True,
) -> list[str]:
    """Return the pose of a prim in its parent's frame: for every frame, or constant."""
    tracks = {"double3 xformOp:translate": map(vector, positions)}
    if orientations is not None:
        tracks["quatd xformOp:orient"] = map(turn, orientations)
    lines = []
    for declaration, values in tracks.items():
        lines += animated(declaration, values) if is_moving else [f"{declaration} = {next(values)}"]
    order = tokens(declaration.split()[1] for declaration in tracks)
    return [*lines, f"uniform token[] xformOpOrder = {order}"]


def _skeleton(joints: Sequence[str], bind: str, rest: str, path: str) -> Prim:
    """Return a skeleton of `joints` with poses in the bind pose and at rest, which follows the motion at the `path`."""
    rig = Prim("Skeleton", "bones", metadata=['prepend apiSchemas = ["SkelBindingAPI"]'])
    rig.properties = [
        f"uniform token[] joints = {tokens(joints)}",
        f"uniform matrix4d[] bindTransforms = {bind}",
        f"uniform matrix4d[] restTransforms = {rest}",
        f"rel skel:animationSource = <{path}/motion>",
    ]
    return rig


def _matrices(matrices: Float[np.ndarray, "J 4 4"]) -> str:
    """Return column-vector matrices in the format's convention, row vectors."""
    rows = [f"({', '.join(map(vector, matrix.T))})" for matrix in matrices]
    return f"[{', '.join(rows)}]"


def _boxes(clip: Clip, skin: SkinNode) -> Float[np.ndarray, "F 2 3"]:
    """Return the corners of a box around the skin in each frame: the bones, and as far as the skin reaches from one."""
    mesh = skin.mesh
    away = np.linalg.norm(mesh.points[:, None] - mesh.bind_positions[mesh.bones], axis=2)
    reach = away[mesh.weights > 0].max()
    positions, _ = clip.skeleton.world_poses(clip.states)
    return np.stack([positions.min(axis=1) - reach, positions.max(axis=1) + reach], axis=1)


def _display_colours(colours: Float[np.ndarray, "V 3"] | None) -> str:
    """Return the property of the linear colours of points."""
    assert colours is not None
    return f'color3f[] primvars:displayColor = {array(colours)} (interpolation = "vertex")'


def _mesh_prim(
    name: str, points: np.ndarray, normals: np.ndarray | None, triangles: np.ndarray
) -> Prim:
    """Return a mesh; one without `normals` stays smooth when its points move."""
    extent = np.stack([points.min(axis=0), points.max(axis=0)])
    scheme = "loop" if normals is None else "none"
    prim = Prim("Mesh", name)
    prim.properties = [
        f'uniform token subdivisionScheme = "{scheme}"',
        f"float3[] extent = {array(extent)}",
        f"int[] faceVertexCounts = {array(np.full(len(triangles), 3))}",
        f"int[] faceVertexIndices = {array(triangles.ravel())}",
        f"point3f[] points = {array(points)}",
    ]
    if normals is not None:
        prim.properties.append(f'normal3f[] normals = {array(normals)} (interpolation = "vertex")')
    return prim


def _converted(text: bytes, suffix: str) -> bytes:
    """Return the same scene, written by Pixar's library."""
    try:
        from pxr import Sdf, UsdUtils  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise ResourceError(
            f"A {suffix} file is made by usd-core, which is missing. Install it with: pip install 'neuroanimator[usd]'; "
            "or write .usda, which needs no package."
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
