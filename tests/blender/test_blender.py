"""The extension in real Blender, where its Python is at hand; and everywhere, that its poses are this package's."""

from __future__ import annotations

import importlib.util
import os
import runpy
import subprocess
from pathlib import Path
from types import ModuleType

import numpy as np
import numpy_runtime
import pytest
from npz_file import write_npz

import neuroanimator as na
from neuroanimator.animation.interpolate import interpolate_hermite
from neuroanimator.animation.motion import default_drive, named_start, random_drive
from neuroanimator.animation.push_out import push_out
from neuroanimator.appearance.colour import linear_of
from neuroanimator.appearance.shapes import Shapes
from neuroanimator.export.morphs import surface_normals
from neuroanimator.state.pose import read_pose

ROOT = Path(__file__).parents[2] / "blender"
PYTHON = os.environ.get("BLENDER_PYTHON", "")
"""A Python that has the wheel bpy."""

SYSTEMS = ("truck", pytest.param("lander", marks=pytest.mark.endurance), "fish")
SOFT = ("cape", "flag", "jelly")


@pytest.fixture(scope="module")
def poses() -> ModuleType:
    spec = importlib.util.spec_from_file_location("poses", ROOT / "extension" / "poses.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", SYSTEMS)
def test_states_become_the_same_poses_in_blender(name: str, poses: ModuleType, tmp_path: Path):
    emulator = na.load_emulator(name)
    write_npz(emulator, tmp_path / "creature.npz")
    states = random_drive(emulator, 2.0, 3).motion(emulator)
    body = numpy_runtime.load(tmp_path / "creature.npz").body
    times = np.arange(40) / 24
    frames = poses.between(states, emulator.dt, times, body["rates"], body["orientations"])
    orientations = emulator.state_structure.orientations
    expected = interpolate_hermite(states, emulator.dt, times, emulator.spec.rates, orientations)
    bones = emulator.spec.skeleton.local_poses(expected)
    for number, (position, orientation) in enumerate(poses.local_poses(body["bones"], frames)):
        np.testing.assert_allclose(position, bones[0][:, number], atol=1e-6)
        same = np.abs((orientation * bones[1][:, number]).sum(axis=-1))
        np.testing.assert_allclose(same, 1, atol=1e-9)
    found = poses.pose_of(body["root"], states[-1])
    if found is not None:
        pose = read_pose(emulator.state_structure, states[-1])
        np.testing.assert_allclose(found[0], pose.position, atol=1e-6)
        np.testing.assert_allclose(found[1], pose.forward, atol=1e-6)
        np.testing.assert_allclose(found[2], pose.upward, atol=1e-6)
        np.testing.assert_allclose(found[3], pose.roll, atol=1e-6)


def write_soft_bodies(folder: Path) -> dict[str, np.ndarray]:
    """Write a second of every soft body that ships into `folder`, and return what is to be seen of it."""
    expected = {"cloth_light": linear_of(Shapes.rgba[:3])}
    for name in SOFT:
        emulator = na.load_emulator(name)
        states = default_drive(emulator).motion(emulator)[:40]
        clip = push_out(na.make_clip(emulator, states), emulator)
        na.write_glb(clip, folder / f"{name}.glb")
        na.write_usd(clip, folder / f"{name}.usda")
        shapes = clip.skeleton.shapes
        assert shapes is not None
        frames = np.array([0, len(clip.times) // 2, len(clip.times) - 1])
        expected[f"{name}_frames"] = frames
        expected[f"{name}_points"] = shapes.decode(clip.states[frames])
        expected[f"{name}_normals"] = surface_normals(shapes, expected[f"{name}_points"])
        expected[f"{name}_drawn"] = np.unique(shapes.faces)
    return expected


@pytest.mark.skipif(not PYTHON, reason="BLENDER_PYTHON names no Python with the wheel bpy")
def test_a_person_in_blender(tmp_path: Path):
    extension = tmp_path / "neuroanimator.zip"
    runpy.run_path(str(ROOT / "build.py"))["build"](extension)
    expected = {}
    for name, controls in (("fish", "gait"), ("lander", "idle")):
        emulator = na.load_emulator(f"{name}-50")
        count = round(2.0 / emulator.dt)
        steps = np.repeat(emulator.bounds.middle[None], count, axis=0)
        if controls == "gait":
            assert emulator.gait is not None
            steps = emulator.gait.controls(count, emulator.dt, emulator.bounds)
        states = [emulator.rest]
        if name == "lander":
            states = [
                named_start(emulator, {"root.position": [3, -2, 8], "root.velocity": [0, 0, -0.5]})
            ]
        for control in steps:
            states.append(np.asarray(emulator.step(states[-1], control)))
        clip = na.make_clip(emulator, np.array(states), rate=24)
        expected[name] = emulator.spec.skeleton.world_poses(clip.states)[0]
    truck = na.load_emulator("truck")
    clip = na.make_clip(truck, random_drive(truck, 2.0, 3).motion(truck), rate=24)
    na.write_glb(clip, tmp_path / "truck.glb")
    na.write_usd(clip, tmp_path / "truck.usda")
    bones = [bone.name for bone in clip.skeleton.bones]
    expected["truck"] = clip.skeleton.world_poses(clip.states)[0][:, bones.index("chassis")]
    chassis = clip.skeleton.bones[bones.index("chassis")]
    expected["truck_light"] = linear_of([shape.colour[:3] for shape in chassis.shapes])
    expected |= write_soft_bodies(tmp_path)
    np.savez(tmp_path / "expected.npz", **expected)
    command = [
        PYTHON,
        Path(__file__).with_name("session.py"),
        extension,
        tmp_path / "expected.npz",
        tmp_path,
    ]
    environment = {
        **os.environ,
        "BLENDER_USER_RESOURCES": str(tmp_path / "blender"),
        "PYTHONPATH": "",
    }
    session = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert session.returncode == 0, session.stdout[-2000:] + session.stderr[-3000:]
    assert "everything holds in Blender" in session.stdout
