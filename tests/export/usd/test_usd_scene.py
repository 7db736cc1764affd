"""USD files hold against Pixar's own library: valid, with every bone where the skeleton has it, and hostile names harmless."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from neuroanimator import Clip, load_system, write_usd
from neuroanimator.appearance.part_names import identifier
from neuroanimator.appearance.skeleton import MAX_BONES, Skeleton
from neuroanimator.appearance.skin_mesh import skin_mesh
from neuroanimator.errors import ArgumentError
from neuroanimator.export.ghost import GHOST_OPACITY
from neuroanimator.export.usd.prims import string
from neuroanimator.state.rotation import rotation_matrices

pxr = pytest.importorskip("pxr")

from pxr import Gf, Usd, UsdGeom, UsdShade, UsdSkel, UsdValidation  # noqa: E402

SYSTEMS = ("pendulum", "truck", "lander", "fish", "dolphin", "cube")
FRAMES = 7


def a_clip(name: str) -> Clip:
    """Return a made-up motion: every number of the state drifts, so that everything that can turn turns."""
    system = load_system(name)
    drift = np.linspace(0, 0.1, FRAMES)[:, None] * np.sin(1 + np.arange(len(system.rest)))
    states = system.rest + drift
    for entry, _ in system.structure.orientations:
        states[:, entry : entry + 4] /= np.linalg.norm(
            states[:, entry : entry + 4], axis=1, keepdims=True
        )
    return Clip(name, system.skeleton, np.arange(FRAMES) / 24, states, source="physics")


def opened(path: Path) -> Usd.Stage:
    return Usd.Stage.Open(str(path))


@pytest.mark.parametrize(
    ("name", "suffix"),
    [*((name, ".usda") for name in SYSTEMS), ("truck", ".usdc"), ("fish", ".usdz")],
)
def test_pixars_validators_find_nothing(name: str, suffix: str, tmp_path: Path):
    clip = a_clip(name)
    path = tmp_path / f"a{suffix}"
    write_usd(clip, path, ghost=clip)
    every = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    errors = UsdValidation.ValidationContext(every).Validate(opened(path))
    assert [error.GetMessage() for error in errors] == []


@pytest.mark.parametrize("name", ["pendulum", "truck", "lander"])
def test_bones_are_where_the_skeleton_has_them_in_every_frame(name: str, tmp_path: Path):
    clip = a_clip(name)
    write_usd(clip, tmp_path / "a.usda")
    stage = opened(tmp_path / "a.usda")
    positions, orientations = clip.skeleton.world_poses(clip.states)
    by_name = {prim.GetDisplayName(): prim for prim in stage.Traverse() if prim.GetDisplayName()}
    for number, bone in enumerate(clip.skeleton.bones):
        for frame in range(FRAMES):
            cache = UsdGeom.XformCache(Usd.TimeCode(frame))
            matrix = np.array(cache.GetLocalToWorldTransform(by_name[bone.name]))
            np.testing.assert_allclose(matrix[3, :3], positions[frame, number], atol=1e-5)
            turn = rotation_matrices(orientations[frame, number])
            np.testing.assert_allclose(matrix[:3, :3].T, turn, atol=1e-5)


@pytest.mark.parametrize("name", ["fish", "cube"])
def test_a_skin_follows_its_bones_as_the_skeleton_has_them(name: str, tmp_path: Path):
    clip = a_clip(name)
    write_usd(clip, tmp_path / "a.usda")
    stage = opened(tmp_path / "a.usda")
    (rig,) = [prim for prim in stage.Traverse() if prim.IsA(UsdSkel.Skeleton)]
    query = UsdSkel.Cache().GetSkelQuery(UsdSkel.Skeleton(rig))
    positions, orientations = clip.skeleton.world_poses(clip.states)
    joints = query.ComputeJointSkelTransforms(Usd.TimeCode(FRAMES - 1))
    # The first joint is the root, which stays where it is.
    np.testing.assert_array_equal(joints[0], np.eye(4))
    for number, matrix in enumerate(np.array(joints)[1:]):
        np.testing.assert_allclose(matrix[3, :3], positions[-1, number], atol=1e-5)
        turn = rotation_matrices(orientations[-1, number])
        np.testing.assert_allclose(matrix[:3, :3].T, turn, atol=1e-5)
    skinning = np.array(query.ComputeSkinningTransforms(Usd.TimeCode(0)))[1:]
    for number, bone in enumerate(
        clip.skeleton.bones
    ):  # what takes a point of the skin at rest along
        joint = np.append(bone.offset, 1) @ skinning[number]
        np.testing.assert_allclose(joint[:3], positions[0, number], atol=1e-5)


@pytest.mark.parametrize("name", ["fish", "dolphin"])
def test_a_cache_of_boxes_goes_along_with_a_skin(name: str, tmp_path: Path):
    """USD's own box of a skin without an extent is that of the first time asked for."""
    clip = a_clip(name)
    states = clip.states.copy()
    states[:, :3] += np.linspace(0, 5, FRAMES)[:, None]
    write_usd(replace(clip, states=states), tmp_path / "a.usda")
    stage = opened(tmp_path / "a.usda")
    (root,) = [prim for prim in stage.Traverse() if prim.IsA(UsdSkel.Root)]
    cache = UsdGeom.BBoxCache(0, ["default"])
    boxes = []
    for frame in range(FRAMES):
        cache.SetTime(frame)
        boxes.append(cache.ComputeWorldBound(root).ComputeAlignedRange())
    UsdSkel.BakeSkinning(UsdSkel.Root(root), Gf.Interval(0, FRAMES - 1))
    (mesh,) = [prim for prim in Usd.PrimRange(root) if prim.IsA(UsdGeom.Mesh)]
    for frame, box in enumerate(boxes):
        points = np.array(UsdGeom.Mesh(mesh).GetPointsAttr().Get(frame))
        assert (points.min(axis=0) >= np.array(box.GetMin()) - 1e-5).all()
        assert (points.max(axis=0) <= np.array(box.GetMax()) + 1e-5).all()
        assert (np.array(box.GetSize()) < 3 * np.ptp(points, axis=0).max()).all()


def test_a_skins_parts_can_be_painted_and_hold_all_of_its_triangles(tmp_path: Path):
    clip = a_clip("dolphin")
    write_usd(clip, tmp_path / "a.usda")
    stage = opened(tmp_path / "a.usda")
    subsets = [UsdGeom.Subset(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Subset)]
    faces = np.concatenate([subset.GetIndicesAttr().Get() for subset in subsets])
    assert sorted(faces) == list(range(len(skin_mesh(clip.skeleton).triangles)))
    for subset in subsets:
        material, _ = UsdShade.MaterialBindingAPI(subset).ComputeBoundMaterial()
        assert material.GetPrim().GetName() == subset.GetPrim().GetName()


def test_scale_rate_axes_and_source_are_said(tmp_path: Path):
    write_usd([a_clip("fish"), a_clip("fish")], tmp_path / "a.usda")
    stage = opened(tmp_path / "a.usda")
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1
    assert stage.GetTimeCodesPerSecond() == pytest.approx(24)
    assert stage.GetEndTimeCode() == FRAMES - 1
    bodies = stage.GetDefaultPrim().GetChildren()
    assert [body.GetName() for body in bodies] == ["fish_1", "fish_2"]
    assert bodies[0].GetCustomDataByKey("source") == "physics"


def test_a_ghost_has_one_translucent_colour_and_no_scenery(tmp_path: Path):
    clip = a_clip("truck")
    write_usd(clip, tmp_path / "a.usda", ghost=clip)
    stage = opened(tmp_path / "a.usda")
    body, ghost = stage.GetDefaultPrim().GetChildren()
    is_mesh = lambda prim: prim.IsA(UsdGeom.Mesh)  # noqa: E731
    ghostly = [prim for prim in Usd.PrimRange(ghost) if is_mesh(prim)]
    scenery = [
        number for number in range(len(clip.skeleton.bones)) if not clip.skeleton.is_moved(number)
    ]
    shapes = sum(len(clip.skeleton.bones[number].shapes) for number in scenery)
    assert len([prim for prim in Usd.PrimRange(body) if is_mesh(prim)]) - len(ghostly) == shapes
    for prim in ghostly:
        material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()
        (shader,) = material.GetPrim().GetChildren()
        opacity = UsdShade.Shader(shader).GetInput("opacity").Get()
        assert opacity == pytest.approx(GHOST_OPACITY)


@pytest.mark.attack
@pytest.mark.parametrize(
    "name",
    [
        'a" { } def Xform "b',
        "a\n)\n",
        "<script>",
        "@/etc/passwd@",
        "1",
        "",
        "a b",
        "höhe",
        "\x1b[2J",
    ],
)
def test_hostile_names_stay_names(name: str, tmp_path: Path):
    clip = a_clip("pendulum")
    bones = list(clip.skeleton.bones)
    bones[-1] = replace(bones[-1], name=name)
    hostile = replace(clip, skeleton=Skeleton(tuple(bones)), name=name, source=name)
    write_usd(hostile, tmp_path / "a.usda")
    honest = tmp_path / "b.usda"
    write_usd(clip, honest)
    stages = [opened(path) for path in (tmp_path / "a.usda", honest)]
    count, honest_count = (len(list(stage.Traverse())) for stage in stages)
    assert count == honest_count
    assert identifier(name, set()).replace("_", "a").isalnum()
    assert string(name).isprintable()


@pytest.mark.attack
def test_a_chain_of_as_many_bones_as_there_may_be_is_written_and_read(tmp_path: Path):
    clip = a_clip("pendulum")
    last = clip.skeleton.bones[-1]
    bones = [
        replace(last, name=f"b{number}", parent=number - 1, shapes=())
        for number in range(MAX_BONES)
    ]
    write_usd(replace(clip, skeleton=Skeleton(tuple(bones))), tmp_path / "a.usda")
    stage = opened(tmp_path / "a.usda")
    names = {prim.GetDisplayName() for prim in stage.Traverse()}
    assert names >= {bone.name for bone in bones}


def test_what_cannot_be_drawn_together_is_refused(tmp_path: Path):
    with pytest.raises(ArgumentError, match="clips: wanted 1 to 1000 in one file, got 0"):
        write_usd([], tmp_path / "a.usda")
    with pytest.raises(ArgumentError, match="ghost: wanted another motion of the same body"):
        write_usd(a_clip("fish"), tmp_path / "a.usda", ghost=a_clip("truck"))
    assert not (tmp_path / "a.usda").exists()
