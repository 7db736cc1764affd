"""NeuroAnimator in Blender: add a creature, say where it starts and what it is told, bake its motion to keyframes.

Add > NeuroAnimator, or File > Import > NeuroAnimator emulator (.npz), which
`python blender/npz_file.py my_robot.emulator.safetensors` writes. Then the sidebar's tab NeuroAnimator.
"""

from pathlib import Path

import bpy
from bpy.props import (
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)
from bpy_extras.io_utils import ImportHelper

from . import bake, creature

DRIVES = [
    ("GAIT", "Gait", "By its swimming pattern"),
    ("STEERED", "Steered", "By a policy, at a commanded speed and heading"),
    ("CONTROLS", "Controls", "By motors, muscles and thrusters set by hand"),
]


class Settings(bpy.types.PropertyGroup):
    """What a creature is told. Numbers may be animated; they count when each super step begins."""

    path: StringProperty(
        name="Emulator", description="File of the emulator (.npz)", subtype="FILE_PATH"
    )
    first_frame: IntProperty(name="First frame", default=1)
    seconds: FloatProperty(
        name="Seconds", description="Length of the motion", default=5.0, min=0.01, max=3600.0
    )
    start: StringProperty(
        name="Start",
        description="Parts of the initial state, such as root.position=0,0,8; at rest if empty",
    )
    drive: EnumProperty(name="Drive", items=DRIVES, default="CONTROLS")
    strength: FloatProperty(
        name="Strength",
        description="Strength of the gait; 1 is its own",
        default=1.0,
        min=0.0,
        max=2.0,
    )
    target: PointerProperty(name="Target", description="Object to move to", type=bpy.types.Object)
    speed: FloatProperty(
        name="Speed", description="Commanded speed [m/s]", default=0.12, soft_min=0.0, soft_max=10.0
    )
    turn: FloatProperty(
        name="Turn",
        description="Commanded turn to the left, per second",
        default=0.0,
        subtype="ANGLE",
        soft_min=-2.0,
        soft_max=2.0,
    )
    climb: FloatProperty(
        name="Climb",
        description="Commanded climb angle",
        default=0.0,
        subtype="ANGLE",
        soft_min=-1.0,
        soft_max=1.0,
    )
    controls: FloatVectorProperty(
        name="Controls",
        size=bake.MAX_CONTROLS,
        default=[0.0] * bake.MAX_CONTROLS,
        min=-1.0,
        max=1.0,
    )


def root_of(thing):
    """Return the root of the creature that an object belongs to, or None."""
    while thing is not None and not thing.neuroanimator.path:
        thing = thing.parent
    return thing


def _add(operator, context, path):
    """Add a creature; report what is wrong in one line."""
    try:
        root = creature.add_creature(context, path)
    except (OSError, ValueError) as error:
        operator.report({"ERROR"}, f"{Path(path).name}: {error}")
        return {"CANCELLED"}
    model = creature.model_of(path)
    if creature.policy_path(path) is not None:
        root.neuroanimator.drive = "STEERED"
        root.neuroanimator.speed = 0.6 * model_top_speed(path)
    elif "gait" in model.body:
        root.neuroanimator.drive = "GAIT"
    for thing in context.selected_objects:
        thing.select_set(False)
    root.select_set(True)
    context.view_layer.objects.active = root
    return {"FINISHED"}


def model_top_speed(path):
    """Return the highest speed [m/s] that the policy beside `path` was taught."""
    return creature.model_of(creature.policy_path(path)).facts["command_high"][0]


class AddCreature(bpy.types.Operator):
    """Add a creature that comes with the extension"""

    bl_idname = "neuroanimator.add"
    bl_label = "Add creature"
    bl_options = {"REGISTER", "UNDO"}

    name: StringProperty(name="Creature", default="fish")

    def execute(self, context):
        paths = dict(creature.shipped())
        if self.name not in paths:
            self.report(
                {"ERROR"}, f"No creature called '{self.name}'. Creatures: {', '.join(paths)}."
            )
            return {"CANCELLED"}
        return _add(self, context, paths[self.name])


class ImportEmulator(bpy.types.Operator, ImportHelper):
    """Add the body of an emulator from a file that blender/npz_file.py wrote"""

    bl_idname = "neuroanimator.import_emulator"
    bl_label = "NeuroAnimator emulator (.npz)"
    bl_options = {"REGISTER", "UNDO"}
    filename_ext = ".npz"
    filter_glob: StringProperty(default="*.npz", options={"HIDDEN"})

    def execute(self, context):
        return _add(self, context, self.filepath)


class Bake(bpy.types.Operator):
    """Move the creature through its emulator, and set keyframes of its bones"""

    bl_idname = "neuroanimator.bake"
    bl_label = "Bake motion"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        return root_of(context.object) is not None

    def execute(self, context):
        manager = context.window_manager
        manager.progress_begin(0, 100)
        try:
            count = bake.bake(
                context, root_of(context.object), lambda share: manager.progress_update(100 * share)
            )
        except (OSError, ValueError, bake.LostError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        finally:
            manager.progress_end()
        self.report({"INFO"}, f"{count} frames")
        return {"FINISHED"}


class Sidebar(bpy.types.Panel):
    """Settings of the creature that is selected"""

    bl_idname = "VIEW3D_PT_neuroanimator"
    bl_label = "NeuroAnimator"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "NeuroAnimator"

    def draw(self, context):
        root = root_of(context.object)
        if root is None:
            self.layout.label(text="Select a creature, or add one (Add menu).")
            return
        bake.draw_settings(self.layout, root)
        self.layout.operator(Bake.bl_idname, icon="REC")


class AddMenu(bpy.types.Menu):
    """Creatures that come with the extension"""

    bl_idname = "VIEW3D_MT_neuroanimator"
    bl_label = "NeuroAnimator"

    def draw(self, context):
        for name, _ in creature.shipped():
            self.layout.operator(AddCreature.bl_idname, text=name).name = name


def _in_add_menu(self, context):
    self.layout.menu(AddMenu.bl_idname)


def _in_import_menu(self, context):
    self.layout.operator(ImportEmulator.bl_idname)


CLASSES = (Settings, AddCreature, ImportEmulator, Bake, Sidebar, AddMenu)


def register():
    for each in CLASSES:
        bpy.utils.register_class(each)
    bpy.types.Object.neuroanimator = PointerProperty(type=Settings)
    bpy.types.VIEW3D_MT_add.append(_in_add_menu)
    bpy.types.TOPBAR_MT_file_import.append(_in_import_menu)


def unregister():
    bpy.types.TOPBAR_MT_file_import.remove(_in_import_menu)
    bpy.types.VIEW3D_MT_add.remove(_in_add_menu)
    del bpy.types.Object.neuroanimator
    for each in reversed(CLASSES):
        bpy.utils.unregister_class(each)
