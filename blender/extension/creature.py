"""A creature in a scene: a root empty with settings, and below it the bones, their meshes and the skin.

The root may be moved and turned about the vertical: motions are the same everywhere. Nothing here keeps references to
Blender's data, so undo and redo are safe; emulators are read once and kept by path.
"""

from functools import lru_cache
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Quaternion, Vector

from . import numpy_runtime

FOLDER = Path(__file__).parent / "emulators"
"""Emulators that come with the extension."""

BONE_LENGTH = 0.15
"""Length of a bone of an armature, over the body's longest side."""

MARK = "neuroanimator_material"
"""Property of a material that says what it was made for."""


@lru_cache(maxsize=8)
def _read(path, changed):
    return numpy_runtime.load(path)


def model_of(path):
    """Return the model in an .npz file, read anew if it changed; ValueError or OSError if there is none."""
    path = Path(path)
    return _read(str(path), path.stat().st_mtime_ns)


def policy_path(path):
    """Return the file of the policy that steers the emulator in `path`: beside it, fish.policy.npz for fish.npz; or None."""
    policy = Path(path).with_suffix(".policy.npz")
    return policy if policy.is_file() else None


def shipped():
    """Return (name, path) of the emulators that come with the extension."""
    files = sorted(FOLDER.glob("*.npz"))
    return [(path.stem, str(path)) for path in files if not path.stem.endswith(".policy")]


def add_creature(context, path):
    """Return the root of a new creature of the emulator in `path`, at the 3D cursor; ValueError if nothing is to be drawn."""
    model = model_of(path)
    if not model.body.get("bones"):
        raise ValueError("it has no bodies to draw, only numbers")
    collection = bpy.data.collections.new(model.facts["system"])
    context.scene.collection.children.link(collection)
    root = bpy.data.objects.new(model.facts["system"], None)
    collection.objects.link(root)
    root.empty_display_size = 0.5 * body_size(model)
    root.location = context.scene.cursor.location
    root.neuroanimator.path = str(path)
    if "skin_points" in model.arrays:
        _add_skin(model, root, collection)
    else:
        _add_bones(model, root, collection)
    return root


def body_size(model):
    """Return the longest side of what moves, at rest [m]."""
    points = [model.arrays["skin_points"]] if "skin_points" in model.arrays else []
    if not points:
        for bone in model.body["bones"]:
            if not bone["is_scenery"]:
                points += [model.arrays[f"{shape['array']}_points"] for shape in bone["shapes"]]
    return float(np.ptp(np.concatenate(points), axis=0).max()) if points else 1.0


def parts_of(root):
    """Return the objects that bones move, by the bone's number; of a skinned body its armature alone, by -1."""
    return {
        part["neuroanimator_bone"]: part
        for part in root.children_recursive
        if "neuroanimator_bone" in part
    }


def rest_matrix(bone):
    """Return the transform at rest of a bone that goes with mass points."""
    return Matrix.LocRotScale(Vector(bone["offset"]), Quaternion(bone["orientation"]), None)


def _add_bones(model, root, collection):
    objects = []
    for number, bone in enumerate(model.body["bones"]):
        part = bpy.data.objects.new(bone["name"], None)
        collection.objects.link(part)
        part.empty_display_size = 0.02
        part.rotation_mode = "QUATERNION"
        part.parent = objects[bone["parent"]] if bone["parent"] >= 0 else root
        part.location = bone["offset"]
        part.rotation_quaternion = bone["orientation"]
        part["neuroanimator_bone"] = number
        for shape in bone["shapes"]:
            mesh = _mesh(bone["name"], model.arrays, shape["array"])
            mesh.materials.append(_material(bone["name"], shape["light"]))
            drawn = bpy.data.objects.new(bone["name"], mesh)
            drawn.parent = part
            collection.objects.link(drawn)
        objects.append(part)


def _add_skin(model, root, collection):
    """Add an armature with the bones, and the mesh that follows them."""
    armature = bpy.data.armatures.new("bones")
    rig = bpy.data.objects.new("bones", armature)
    rig.parent = root
    rig["neuroanimator_bone"] = -1
    collection.objects.link(rig)
    _make_bones(rig, model.body["bones"], BONE_LENGTH * body_size(model))
    mesh = _mesh("skin", model.arrays, "skin")
    colours = mesh.color_attributes.new("colour", "FLOAT_COLOR", "POINT")
    light = np.ones((len(mesh.vertices), 4), np.float32)
    light[:, :3] = model.arrays["skin_light"]
    colours.data.foreach_set("color", light.ravel())
    mesh.materials.append(_material("skin", None))
    skin = bpy.data.objects.new("skin", mesh)
    skin.parent = rig
    collection.objects.link(skin)
    for number, bone in enumerate(model.body["bones"]):
        group = skin.vertex_groups.new(name=bone["name"])
        of_bone = (model.arrays["skin_bones"] == number) * model.arrays["skin_weights"]
        weights = of_bone.sum(axis=1)
        for vertex in np.flatnonzero(weights > 0):
            group.add([int(vertex)], float(weights[vertex]), "REPLACE")
    modifier = skin.modifiers.new("bones", "ARMATURE")
    modifier.object = rig


def _make_bones(rig, bones, length):
    view_layer = bpy.context.view_layer
    before = view_layer.objects.active
    view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    for bone in bones:
        made = rig.data.edit_bones.new(bone["name"])
        made.head = bone["offset"]
        made.tail = Vector(bone["offset"]) + Vector((0.0, 0.0, length))
    bpy.ops.object.mode_set(mode="OBJECT")
    view_layer.objects.active = before
    for pose_bone in rig.pose.bones:
        pose_bone.rotation_mode = "QUATERNION"


def _mesh(name, arrays, prefix):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(
        arrays[f"{prefix}_points"].tolist(), [], arrays[f"{prefix}_triangles"].tolist()
    )
    mesh.shade_smooth()
    return mesh


def _material(name, light):
    """Return a material of a colour, as amounts of light and opacity; of the points' own colours if there is none.

    Creatures of a kind share it. It is found by a mark, as people rename materials and change their colours.
    """
    mark = f"{name} {light}"
    for material in bpy.data.materials:
        if material.get(MARK) == mark:
            return material
    material = bpy.data.materials.new(name)
    material[MARK] = mark
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    surface = nodes["Principled BSDF"]
    surface.inputs["Roughness"].default_value = 0.45
    if light is None:
        reader = nodes.new("ShaderNodeVertexColor")
        reader.layer_name = "colour"
        links.new(reader.outputs["Color"], surface.inputs["Base Color"])
        return material
    surface.inputs["Base Color"].default_value = (*light[:3], 1.0)
    surface.inputs["Alpha"].default_value = light[3]
    material.diffuse_color = light
    return material
