"""What Unreal, and every engine, wants of a skinned body: one root, plain names of their own, nothing scaled."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from conftest import accessor, read_glb

from neuroanimator import Clip, load_system, write_glb, write_usd

SKINNED = ("cube", "dolphin", "fish")
PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
MAX_INFLUENCES = 8
"""Bones that a point may follow in Unreal without further ado."""


def a_clip(name: str) -> Clip:
    """Return a body that drifts."""
    system = load_system(name)
    assert system.skeleton.skin is not None
    states = system.rest + np.linspace(0, 0.1, 5)[:, None] * np.sin(np.arange(len(system.rest)))
    return Clip(name, system.skeleton, np.arange(5) / 30, states)


def test_every_system_with_a_skin_is_tried():
    systems = ("cube", "dolphin", "fish", "lander", "pendulum", "pendulum-passive", "truck")
    assert [name for name in systems if load_system(name).skeleton.skin is not None] == [*SKINNED]


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("name", SKINNED)
def test_a_glb_has_one_root_bone_a_body_plain_names_and_no_scales(
    name: str, count: int, tmp_path: Path
):
    write_glb([a_clip(name)] * count, tmp_path / "a.glb")
    document, binary = read_glb(tmp_path / "a.glb")
    nodes = document["nodes"]
    assert not any("scale" in node or "matrix" in node for node in nodes)
    paths = {channel["target"]["path"] for channel in document["animations"][0]["channels"]}
    assert paths <= {"rotation", "translation"}
    parents = {child: n for n, node in enumerate(nodes) for child in node.get("children", [])}
    assert len(document["skins"]) == count
    names = []
    for skin in document["skins"]:
        joints = skin["joints"]
        roots = [joint for joint in joints if parents.get(joint) not in joints]
        assert roots == [skin["skeleton"]]
        assert roots[0] not in parents
        names += [nodes[joint]["name"] for joint in joints]
        matrices = accessor(document, binary, skin["inverseBindMatrices"]).astype(float)
        turns = matrices.reshape(-1, 4, 4)[:, :3, :3]
        np.testing.assert_allclose(turns @ turns.transpose(0, 2, 1), np.eye(3)[None] + 0 * turns, atol=1e-6)  # fmt: skip
        np.testing.assert_allclose(np.linalg.det(turns), 1, atol=1e-6)
    assert all(PLAIN.fullmatch(one) for one in names), names
    assert len({one.casefold() for one in names}) == len(names)
    (mesh,) = [document["meshes"][number] for number in {n["mesh"] for n in nodes if "mesh" in n}]
    attributes = mesh["primitives"][0]["attributes"]
    assert "JOINTS_1" not in attributes
    weights = accessor(document, binary, attributes["WEIGHTS_0"])
    used = accessor(document, binary, attributes["JOINTS_0"])[weights > 0]
    assert weights.shape[1] <= MAX_INFLUENCES
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-5)
    assert used.min() >= 1, "no point follows the root"
    assert used.max() < len(document["skins"][0]["joints"])


@pytest.mark.parametrize("name", SKINNED)
def test_a_skin_is_where_its_bones_are_bound(name: str, tmp_path: Path):
    clip = a_clip(name)
    write_glb(clip, tmp_path / "a.glb")
    document, binary = read_glb(tmp_path / "a.glb")
    (skin,) = document["skins"]
    matrices = accessor(document, binary, skin["inverseBindMatrices"]).astype(float)
    bound = np.linalg.inv(matrices.reshape(-1, 4, 4).transpose(0, 2, 1))
    np.testing.assert_array_equal(bound[0], np.eye(4))
    offsets = [bone.offset for bone in clip.skeleton.bones]
    np.testing.assert_allclose(bound[1:, :3, 3], offsets, atol=1e-5)


@pytest.mark.parametrize("name", SKINNED)
def test_a_usd_skeleton_has_one_root_bone_plain_names_and_no_scales(name: str, tmp_path: Path):
    pytest.importorskip("pxr", reason="no USD library: pip install 'neuroanimator[usd]'")
    from pxr import Usd, UsdGeom, UsdSkel

    write_usd(a_clip(name), tmp_path / "a.usda")
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1
    (prim,) = [prim for prim in stage.Traverse() if prim.IsA(UsdSkel.Skeleton)]
    skeleton = UsdSkel.Skeleton(prim)
    joints = skeleton.GetJointsAttr().Get()
    parents = list(UsdSkel.Topology(joints).GetParentIndices())
    assert parents.count(-1) == 1
    names = [joint.split("/")[-1] for joint in joints]
    assert all(PLAIN.fullmatch(one) for one in names)
    assert len({one.casefold() for one in names}) == len(names)
    turns = np.array(skeleton.GetBindTransformsAttr().Get())[:, :3, :3]
    np.testing.assert_allclose(np.linalg.det(turns), 1, atol=1e-6)
    (motion,) = [prim for prim in stage.Traverse() if prim.IsA(UsdSkel.Animation)]
    assert (np.array(UsdSkel.Animation(motion).GetScalesAttr().Get(), float) == 1).all()
