"""The surface of a soft body in a USD file: blend shapes bring its nodes where the states have them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from soft_bodies import distances, soft_clip, wavy_shapes

from neuroanimator import Clip, load_emulator, write_usd
from neuroanimator.appearance.colour import linear_of
from neuroanimator.export.morphs import TOLERANCE

pxr = pytest.importorskip("pxr")

from pxr import Gf, Usd, UsdGeom, UsdSkel, UsdValidation  # noqa: E402


@pytest.mark.parametrize("turns", [False, True])
def test_usd_has_blend_shapes_that_bring_nodes_where_the_states_have_them(
    turns: bool, tmp_path: Path
):
    clip = soft_clip(wavy_shapes(turns=turns), frames=5)
    write_usd(clip, tmp_path / "a.usda", ghost=clip)
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    every = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    errors = UsdValidation.ValidationContext(every).Validate(stage)
    assert [error.GetMessage() for error in errors] == []
    roots = [UsdSkel.Root(prim) for prim in stage.Traverse() if prim.IsA(UsdSkel.Root)]
    assert len(roots) == 2
    for root in roots:
        UsdSkel.BakeSkinning(root, Gf.Interval(0, 4))
        (mesh,) = [prim for prim in Usd.PrimRange(root.GetPrim()) if prim.IsA(UsdGeom.Mesh)]
        points = []
        for frame in range(5):
            own = np.array(UsdGeom.Mesh(mesh).GetPointsAttr().Get(frame), float)
            placed = UsdGeom.XformCache(Usd.TimeCode(frame)).GetLocalToWorldTransform(mesh)
            rows = np.array(placed)
            points.append(own @ rows[:3, :3] + rows[3, :3])
        assert distances(np.array(points), clip).max() < TOLERANCE * 1.1


def test_a_surface_that_keeps_its_shape_is_written_without_blend_shapes(tmp_path: Path):
    clip = soft_clip(wavy_shapes(10), frames=2)
    clip.states[1] = clip.states[0]
    write_usd(clip, tmp_path / "a.usda")
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    assert not [prim for prim in stage.Traverse() if prim.IsA(UsdSkel.BlendShape)]


def test_flesh_has_the_colours_of_its_nodes(tmp_path: Path):
    emulator = load_emulator("trout")
    states = np.repeat(emulator.rest[None], 2, axis=0)
    write_usd(Clip("trout", emulator.skeleton, np.arange(2) / 30, states), tmp_path / "a.usda")
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    every = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert not UsdValidation.ValidationContext(every).Validate(stage)
    (mesh,) = [UsdGeom.Mesh(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
    shown = np.array(mesh.GetDisplayColorAttr().Get())
    np.testing.assert_allclose(shown, linear_of(emulator.skeleton.shapes.colours), atol=1e-5)
