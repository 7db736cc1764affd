"""A model too large for an emulator file, made light without changing its physics.

Nothing looks at textures but people, and most meshes are there to be looked at. Those that collide do so as their convex hulls
(MuJoCo, "Collision detection"), so of them the hulls' corners are kept, of all others the box around them. A body whose mass came
from such a mesh is given that mass by number.
"""

from __future__ import annotations

import struct
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Callable
from itertools import product
from pathlib import PurePosixPath
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Bool, Float

from neuroanimator.systems.rigid.model_xml import Element, refuse

Assets = dict[str, bytes]
"""The files of a model by the names its XML gives them."""

Compile = Callable[[Element, Assets, int], mujoco.MjModel]
"""Returns the model of (its XML, its files, the most corners of a hull; 0 for any number)."""

HULL_CORNERS = (256, 128, 64, 32)
"""Numbers of corners to which hulls are cut down if the model is still too large, the most that fit."""

FLAT = 1e-3
"""A box around a flat mesh is at least this share of its length thick: MuJoCo wants a volume."""

MIN_THICKNESS = 1e-6
"""And at least so thick [m]."""

INERTIA_TOLERANCE = 1e-6
"""Masses and inertias may be off by this share: MuJoCo keeps a mesh's corners in single precision."""

BOX_FACES = (
    *((0, 1, 3), (0, 3, 2), (4, 7, 5), (4, 6, 7), (0, 5, 1), (0, 4, 5)),
    *((2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)),
)
"""The triangles of a box, by the corners as `itertools.product` yields them."""


class LightModel(NamedTuple):
    """A model that fits into an emulator file, and what was left out of it."""

    files: Assets
    """The one XML file, and the meshes it names."""
    note: str
    """What became of textures and meshes, in words."""


def without_pictures(root: Element) -> int:
    """Make all textures white and take skins out, in place, so that their files need not be read; return how many."""
    count = 0
    for parent in root.descendants():
        skins = [child for child in parent.children() if child.tag == "skin"]
        parent[:] = [child for child in parent if child.tag != "skin"]
        count += len(skins)
        for texture in parent.children():
            if texture.tag == "texture" and texture.file_attributes():
                _whiten(texture)
                count += 1
    return count


def _whiten(texture: Element) -> None:
    """Replace a texture's images by white, which leaves a material the colour it says."""
    images = [texture.attrib[name] for name in texture.file_attributes()]
    kept = {
        name: texture.attrib[name] for name in ("name", "type", "class") if name in texture.attrib
    }
    texture.attrib.clear()
    texture.attrib.update({"name": PurePosixPath(images[0]).stem} | kept)
    texture.attrib.update({"builtin": "flat", "rgb1": "1 1 1", "rgb2": "1 1 1"})
    texture.attrib.update({"width": "8", "height": "8"})


def lighten(
    main: str,
    root: Element,
    assets: Assets,
    compile_tree: Compile,
    fits: Callable[[Assets], bool],
    pictures: int,
) -> LightModel:
    """Return the model of `root` and its `assets` as files that `fits`; `root` is changed in place.

    `pictures` were left out of it before. Raises BadFileError, naming what stands in the way, if its physics would not
    stay what it is.
    """
    original = compile_tree(root, assets, 0)
    _check_no_rays(main, original)
    light, counts = _replace_meshes(root, assets, original, "mesh")
    _keep_inertias(main, root, original, compile_tree(root, light, 0))
    reduced = compile_tree(root, light, 0)
    _check_same_physics(main, original, reduced)
    corners = 0
    for corners_allowed in HULL_CORNERS:
        if fits(_as_files(main, root, light)):
            break
        corners = corners_allowed
        reduced = compile_tree(root, light, corners)
        light, _ = _replace_meshes(root, light, reduced, f"mesh-{corners}")
    files = _as_files(main, root, light)
    if not fits(files):
        size = sum(len(content) for content in files.values())
        refuse(
            main,
            "",
            f"its XML and the hulls of its meshes take {size:,} bytes, more than an emulator file carries. Let fewer meshes "
            "collide, use primitive shapes, or write a shorter XML",
        )
    return LightModel(files, _in_words(pictures, counts, corners))


def _as_files(main: str, root: Element, assets: Assets) -> Assets:
    """Return the XML and the assets it names as the files of a model."""
    return {PurePosixPath(main).name: ET.tostring(root, encoding="utf-8")} | assets


def _check_no_rays(main: str, model: mujoco.MjModel) -> None:
    """Refuse a model whose sensors see meshes as they are."""
    if (model.sensor_type == mujoco.mjtSensor.mjSENS_RANGEFINDER).any():
        refuse(
            main,
            "rangefinder",
            "it sees meshes as they are, and these are too large for an emulator file. Remove the sensor, or use simpler meshes",
        )


def _replace_meshes(
    root: Element, assets: Assets, model: mujoco.MjModel, prefix: str
) -> tuple[Assets, Counter[str]]:
    """Point the meshes of `root` to hulls and boxes in files of that `prefix`.

    Returns all assets that are used then, and how many meshes became a hull or a box.
    """
    replaced: Assets = {}
    counts: Counter[str] = Counter()
    is_solid = _solid_meshes(model)
    for element in root.descendants():
        for attribute in element.file_attributes():
            old = element.attrib[attribute]
            mesh = _mesh_of(element, attribute, model)
            if mesh < 0:
                replaced[old] = assets[old]
                continue
            corners = _corners(model, mesh)
            faces: tuple[tuple[int, ...], ...] = ()
            kind = "hull"
            if is_solid[mesh]:
                corners = corners[_hull(model, mesh)]
            else:
                corners = _box(corners)
                faces = BOX_FACES
                kind = "box"
            content = _as_msh(corners, faces)
            if len(content) >= len(assets[old]):
                replaced[old] = assets[old]
                continue
            new = f"{prefix}-{mesh}.msh"
            replaced[new] = content
            element.set(attribute, new)
            _in_own_place(element)
            counts[kind] += 1
    return replaced, counts


def _in_own_place(mesh: Element) -> None:
    """Undo what a mesh element, or its class, says of how its file is to be read: the corners are where they should be."""
    mesh.attrib.pop("content_type", None)
    mesh.set("scale", "1 1 1")
    if mesh.get("filename") is None:
        mesh.set("refpos", "0 0 0")
        mesh.set("refquat", "1 0 0 0")
        mesh.set("inertia", "convex")


def _mesh_of(element: Element, attribute: str, model: mujoco.MjModel) -> int:
    """Return the number of the mesh an element is, -1 if it is none, or not in the model."""
    if element.tag != "mesh":
        return -1
    if attribute == "file":
        return mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_MESH, element.attrib["name"])
    scale = np.array([float(number) for number in element.get("scale", "1 1 1").split()])
    for mesh in range(model.nmesh):
        path = model.paths[model.mesh_pathadr[mesh] :].split(b"\0")[0].decode()
        if path == element.attrib[attribute] and np.allclose(model.mesh_scale[mesh], scale):
            return mesh
    return -1


def _solid_meshes(model: mujoco.MjModel) -> Bool[np.ndarray, " M"]:
    """Return which meshes any geom that can touch something is."""
    can_touch = (model.geom_contype | model.geom_conaffinity) != 0
    can_touch[model.pair_geom1] = True
    can_touch[model.pair_geom2] = True
    measured = [mujoco.mjtSensor.mjSENS_GEOMDIST, mujoco.mjtSensor.mjSENS_GEOMNORMAL]
    measured.append(mujoco.mjtSensor.mjSENS_GEOMFROMTO)
    if np.isin(model.sensor_type, [int(kind) for kind in measured]).any():
        can_touch[:] = True
    is_mesh = model.geom_type == mujoco.mjtGeom.mjGEOM_MESH
    is_solid = np.zeros(model.nmesh, bool)
    is_solid[model.geom_dataid[is_mesh & can_touch]] = True
    return is_solid


def _corners(model: mujoco.MjModel, mesh: int) -> Float[np.ndarray, "V 3"]:
    """Return the corners of a mesh where its file has them, scaled: MuJoCo turns each mesh into its own axes."""
    first = model.mesh_vertadr[mesh]
    turned = model.mesh_vert[first : first + model.mesh_vertnum[mesh]].astype(float)
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, model.mesh_quat[mesh])
    return turned @ rotation.reshape(3, 3).T + model.mesh_pos[mesh]


def _hull(model: mujoco.MjModel, mesh: int) -> np.ndarray:
    """Return the numbers of the corners of a mesh that are on its convex hull, as MuJoCo found it."""
    first = int(model.mesh_graphadr[mesh])
    if first < 0:
        return np.arange(model.mesh_vertnum[mesh])
    count = int(model.mesh_graph[first])
    # numvert, numface, vert_edgeadr[numvert], then vert_globalid[numvert]
    return np.sort(model.mesh_graph[first + 2 + count : first + 2 + 2 * count])


def _box(corners: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "8 3"]:
    """Return the corners of the box around `corners`, nowhere flat."""
    low = corners.min(axis=0)
    high = corners.max(axis=0)
    thickness = max(FLAT * float((high - low).max()), MIN_THICKNESS)
    missing = np.maximum(0.0, thickness - (high - low)) / 2
    ends = np.stack([low - missing, high + missing])
    return np.array([[ends[i, 0], ends[j, 1], ends[k, 2]] for i, j, k in product((0, 1), repeat=3)])


def _as_msh(corners: Float[np.ndarray, "V 3"], faces: tuple[tuple[int, ...], ...]) -> bytes:
    """Return a mesh in MuJoCo's binary format: four counts, corners in single precision, triangles."""
    counts = struct.pack("<4i", len(corners), 0, 0, len(faces))
    return counts + corners.astype("<f4").tobytes() + np.array(faces, "<i4").tobytes()


def _keep_inertias(
    main: str, root: Element, original: mujoco.MjModel, reduced: mujoco.MjModel
) -> None:
    """Give each body whose mass came from a mesh that mass by number, in place."""
    if original.nbody != reduced.nbody:
        refuse(main, "", "its bodies hang on its meshes. Use simpler meshes")
    changed = np.flatnonzero(~_same_inertias(original, reduced))
    if not len(changed):
        return
    for compiler in root.iter("compiler"):
        if compiler.get("inertiafromgeom") == "true":
            compiler.set("inertiafromgeom", "auto")
    for body in changed.tolist():
        name = original.body(body).name
        elements = [each for each in root.descendants() if _is_body(each, name)]
        if not name or len(elements) != 1 or root.tag == "robot":
            refuse(
                main,
                f"body '{name or body}'",
                "its mass comes from a mesh that is too large for an emulator file. Give it a name and an <inertial>",
            )
        _set_inertia(elements[0], original, body)


def _is_body(element: Element, name: str) -> bool:
    return element.tag == "body" and element.get("name") == name


def _set_inertia(element: Element, model: mujoco.MjModel, body: int) -> None:
    """Write the mass and the inertia of a body into its element."""
    element[:] = [child for child in element if child.tag != "inertial"]
    inertial = Element("inertial")
    inertial.set("mass", repr(float(model.body_mass[body])))
    inertial.set("pos", _written(model.body_ipos[body]))
    inertial.set("quat", _written(model.body_iquat[body]))
    inertial.set("diaginertia", _written(model.body_inertia[body]))
    element.insert(0, inertial)


def _written(numbers: np.ndarray) -> str:
    return " ".join(repr(float(number)) for number in numbers)


def _same_inertias(one: mujoco.MjModel, other: mujoco.MjModel) -> Bool[np.ndarray, " B"]:
    """Return which bodies have the same mass and inertia in both models."""
    return (
        _is_close(one.body_mass[:, None], other.body_mass[:, None])
        & _is_close(_inertia_matrices(one), _inertia_matrices(other))
        & _is_close(one.body_ipos, other.body_ipos)
    )


def _inertia_matrices(model: mujoco.MjModel) -> Float[np.ndarray, "B 9"]:
    """Return each body's inertia about its own axes, whichever way round its principal ones come."""
    matrices = np.empty((model.nbody, 9))
    for body in range(model.nbody):
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, model.body_iquat[body])
        axes = rotation.reshape(3, 3)
        matrices[body] = (axes * model.body_inertia[body] @ axes.T).ravel()
    return matrices


def _is_close(one: np.ndarray, other: np.ndarray) -> Bool[np.ndarray, " B"]:
    size = np.abs(one).max(axis=1, initial=1e-9)
    return np.asarray(np.abs(one - other).max(axis=1, initial=0) <= INERTIA_TOLERANCE * size)


def _check_same_physics(main: str, original: mujoco.MjModel, reduced: mujoco.MjModel) -> None:
    """Refuse a model of which a body has another inertia now, or a geom another size: some take theirs from a mesh."""
    for body in np.flatnonzero(~_same_inertias(original, reduced)):
        name = original.body(body).name
        refuse(
            main,
            f"body '{name or body}'",
            "its inertia depends on meshes too large for an emulator file. Give it an <inertial>",
        )
    is_shape = original.geom_type != mujoco.mjtGeom.mjGEOM_MESH
    sized = np.concatenate([original.geom_size, original.geom_pos], axis=1)[is_shape]
    now = np.concatenate([reduced.geom_size, reduced.geom_pos], axis=1)[is_shape]
    for geom in np.flatnonzero(is_shape)[~_is_close(sized, now)]:
        refuse(
            main,
            f"geom '{original.geom(geom).name or geom}'",
            "its size comes from a mesh that is too large for an emulator file. Give it a size",
        )


def _in_words(pictures: int, counts: Counter[str], corners: int) -> str:
    """Return what became of textures and meshes."""
    parts = []
    if pictures:
        parts.append(f"textures left out: {pictures}")
    if counts["box"]:
        parts.append(f"meshes that touch nothing, drawn as boxes: {counts['box']}")
    if counts["hull"]:
        of_corners = f" of at most {corners} corners" if corners else ""
        parts.append(
            f"meshes that collide, kept as their convex hulls{of_corners}: {counts['hull']}"
        )
    return "; ".join(parts)
