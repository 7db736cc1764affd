"""What a person does in Blender, and checks; run by Blender's own Python (the wheel bpy), not by pytest's.

python session.py EXTENSION.zip EXPECTED.npz FOLDER     see test_blender.py
"""

import sys
from pathlib import Path

import bpy
import numpy as np

extension, expected_path, folder = sys.argv[-3:]
expected = np.load(expected_path)


def settings():
    return bpy.context.object.neuroanimator


def positions(parts, frames):
    """Return where objects, or an armature's bones, are in the world (frame, part, 3)."""
    found = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        found.append([world_position(part) for part in parts])
    return np.array(found)


def world_position(part):
    if isinstance(part, bpy.types.PoseBone):
        return tuple(part.id_data.matrix_world @ part.head)
    return tuple(part.matrix_world.translation)  # a copy: vectors are views


def refused(operator, **arguments):
    """Return what a refused operator says, in one line."""
    try:
        result = operator(**arguments)
    except RuntimeError as error:  # Blender raises what an operator reports
        lines = str(error).removeprefix("Error: ").strip().splitlines()
        assert len(lines) == 1, lines
        return lines[0]
    raise AssertionError(f"not refused: {result}")


def install():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.preferences.edit.use_global_undo = True
    bpy.ops.extensions.package_install_files(
        filepath=extension, repo="user_default", enable_on_install=True
    )


def add_and_bake(name, drive, seconds):
    assert bpy.ops.neuroanimator.add(name=name) == {"FINISHED"}
    settings().drive = drive
    settings().seconds = seconds
    assert bpy.ops.neuroanimator.bake() == {"FINISHED"}
    return bpy.context.object


def check_motion_is_the_emulators():
    scene = bpy.context.scene
    scene.render.fps = 24
    scene.cursor.location = (1.0, 2.0, 3.0)
    for name in ("fish", "lander"):
        root = add_and_bake(name, "GAIT" if name == "fish" else "CONTROLS", 2.0)
        if name == "lander":
            settings().start = "root.position=3,-2,8; root.velocity=0,0,-0.5"
            assert bpy.ops.neuroanimator.bake() == {"FINISHED"}
        wanted = expected[name] + (1.0, 2.0, 3.0)
        rig = next((part for part in root.children if part.type == "ARMATURE"), None)
        if rig is not None:
            parts = list(rig.pose.bones)
        else:
            moving = {
                part["neuroanimator_bone"]: part
                for part in root.children_recursive
                if "neuroanimator_bone" in part
            }
            parts = [moving[number] for number in sorted(moving)]
        found = positions(parts, range(1, len(wanted) + 1))
        np.testing.assert_allclose(found, wanted, atol=2e-4)
        assert np.ptp(found, axis=0).max() > 0.02, "it stands still"


def check_the_skin_goes_with_its_bones():
    root = add_and_bake("fish", "STEERED", 3.0)
    skin = next(part for part in root.children_recursive if part.type == "MESH")
    middles = []
    for frame in (1, 60):
        bpy.context.scene.frame_set(frame)
        shown = skin.evaluated_get(bpy.context.evaluated_depsgraph_get())
        points = np.array([skin.matrix_world @ vertex.co for vertex in shown.data.vertices])
        middles.append(points.mean(axis=0))
        assert 0.2 < np.ptp(points, axis=0).max() < 0.4, "26 cm long"
    assert middles[1][0] - middles[0][0] > 0.1, "it swims ahead"


def check_a_target_is_reached():
    root = add_and_bake("fish", "STEERED", 0.2)
    target = bpy.data.objects.new("target", None)
    bpy.context.collection.objects.link(target)
    target.location = root.location
    target.location.x += 0.5
    target.location.y += 0.6
    settings().target = target
    settings().seconds = 10.0
    settings().speed = 0.14
    assert bpy.ops.neuroanimator.bake() == {"FINISHED"}
    rig = next(part for part in root.children if part.type == "ARMATURE")
    path = positions([rig.pose.bones[0]], range(1, 241))[:, 0]
    assert np.linalg.norm(path - np.array(target.location), axis=-1).min() < 0.1


def check_a_herd_shares_its_materials():
    """Also after the colour of one was changed, which all then have."""
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.neuroanimator.add(name="truck")
    known = {material.name for material in bpy.data.materials}
    changed = bpy.data.materials[sorted(known)[0]]
    changed.diffuse_color = (1.0, 0.0, 0.0, 1.0)
    for _ in range(9):
        bpy.ops.neuroanimator.add(name="truck")
    assert {material.name for material in bpy.data.materials} == known
    assert tuple(changed.diffuse_color) == (1.0, 0.0, 0.0, 1.0)


def check_a_scene_lasts_as_long_as_its_longest_motion():
    bpy.ops.wm.read_homefile(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps = 24
    scene.frame_end = 250
    add_and_bake("fish", "GAIT", 2.0)
    assert scene.frame_end == 250
    settings().first_frame = 11
    settings().seconds = 20.0
    bpy.ops.neuroanimator.bake()
    assert scene.frame_end == 11 + 20 * 24


def check_undo_takes_all_back():
    before = len(bpy.data.objects)
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.neuroanimator.add(name="lander")
    bpy.ops.ed.undo_push(message="added")
    name = bpy.context.object.name
    assert len(bpy.data.objects) > before
    bpy.ops.ed.undo()
    assert len(bpy.data.objects) == before
    bpy.ops.ed.redo()
    assert name in bpy.data.objects
    bpy.context.view_layer.objects.active = bpy.data.objects[name]
    settings().seconds = 0.5
    assert bpy.ops.neuroanimator.bake() == {"FINISHED"}


def check_mistakes_get_one_line_and_lose_nothing():
    root = add_and_bake("lander", "CONTROLS", 0.5)
    keyed = [part for part in root.children_recursive if part.animation_data is not None]
    assert keyed
    settings().start = "root.position=0,0"
    assert "wanted 3 finite numbers for 'root.position'" in refused(bpy.ops.neuroanimator.bake)
    settings().start = "nose=3"
    assert "Start: no part called 'nose'" in refused(bpy.ops.neuroanimator.bake)
    settings().start = ""
    settings().drive = "GAIT"
    assert "has no gait" in refused(bpy.ops.neuroanimator.bake)
    assert all(part.animation_data is not None for part in keyed)
    assert "No creature called 'whale'" in refused(bpy.ops.neuroanimator.add, name="whale")
    junk = Path(folder) / "junk.npz"
    junk.write_bytes(b"PK\x03\x04 nothing")
    assert "junk.npz" in refused(bpy.ops.neuroanimator.import_emulator, filepath=str(junk))


def check_glb_and_usd_arrive_as_they_left():
    """Colours, scale, rate and names of the files that 'animate' writes."""
    for file in ("truck.glb", "truck.usda"):
        bpy.ops.wm.read_homefile(use_empty=True)
        bpy.context.scene.render.fps = 24
        if file.endswith("glb"):
            bpy.ops.import_scene.gltf(filepath=str(Path(folder) / file))
        else:
            bpy.ops.wm.usd_import(filepath=str(Path(folder) / file))
        names = {thing.name for thing in bpy.data.objects}
        assert {"chassis"} <= names, sorted(names)
        chassis = bpy.data.objects["chassis"]
        found = positions([chassis], range(len(expected["truck"])))[:, 0]
        if file.endswith("glb"):  # its first frame is at 0 s, which is frame 0
            np.testing.assert_allclose(found, expected["truck"], atol=1e-3)
        else:
            np.testing.assert_allclose(found[0], expected["truck"][0], atol=1e-3)
        last = (
            max(action.frame_range[1] for action in bpy.data.actions) if bpy.data.actions else None
        )
        assert last is None or round(last) == len(expected["truck"]) - 1
        colours = {
            tuple(round(c, 3) for c in base_colour(material))
            for material in bpy.data.materials
            if material.use_nodes
        }
        wanted = {tuple(round(float(c), 3) for c in row) for row in expected["truck_light"]}
        assert wanted <= colours, (wanted, colours)


def check_soft_surfaces_arrive_as_they_left():
    """Nodes to a millimetre, colour, normals and scale of a cape, a flag and a jelly, in GLB and USD."""
    for name in ("cape", "flag", "jelly"):
        for kind in ("glb", "usda"):
            bpy.ops.wm.read_homefile(use_empty=True)
            bpy.context.scene.render.fps = 30
            path = str(Path(folder) / f"{name}.{kind}")
            if kind == "glb":
                bpy.ops.import_scene.gltf(filepath=path)
            else:
                bpy.ops.wm.usd_import(filepath=path)
            (surface,) = [
                part for part in bpy.data.objects if part.type == "MESH" and part.data.shape_keys
            ]
            np.testing.assert_allclose(
                base_colour(surface.data.materials[0]), expected["cloth_light"], atol=1e-3
            )
            for frame, points, normals in zip(
                expected[f"{name}_frames"],
                expected[f"{name}_points"],
                expected[f"{name}_normals"],
                strict=True,
            ):
                check_surface(surface, int(frame), points, normals, expected[f"{name}_drawn"])


def check_surface(surface, frame, points, normals, drawn):
    """Hold a surface in a frame against nodes [m] and normals; of a solid's some importers keep the `drawn` ones alone."""
    bpy.context.scene.frame_set(frame)
    shown = surface.evaluated_get(bpy.context.evaluated_depsgraph_get())
    matrix = np.array(shown.matrix_world)
    mesh = shown.data
    found = np.array([vertex.co for vertex in mesh.vertices]) @ matrix[:3, :3].T + matrix[:3, 3]
    if len(found) != len(points):
        points = points[drawn]
        normals = normals[drawn]
        drawn = np.arange(len(drawn))
    distances = np.linalg.norm(found - points, axis=1)
    assert np.quantile(distances, 0.99) < 1e-3, "a millimetre"
    assert distances.max() < 1e-2
    turn = matrix[:3, :3] / np.linalg.norm(matrix[:3, :3], axis=0)
    turned = np.array([normal.vector for normal in mesh.vertex_normals]) @ turn.T
    along = (turned * normals).sum(axis=1)[drawn]
    assert np.degrees(np.arccos(np.clip(np.median(along), -1, 1))) < 10


def base_colour(material):
    surface = next(
        (node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED"), None
    )
    return surface.inputs["Base Color"].default_value[:3] if surface else (0.0, 0.0, 0.0)


install()
check_motion_is_the_emulators()
check_the_skin_goes_with_its_bones()
check_a_target_is_reached()
check_a_herd_shares_its_materials()
check_a_scene_lasts_as_long_as_its_longest_motion()
install()
check_undo_takes_all_back()
check_mistakes_get_one_line_and_lose_nothing()
check_glb_and_usd_arrive_as_they_left()
check_soft_surfaces_arrive_as_they_left()
print("everything holds in Blender", bpy.app.version_string)
