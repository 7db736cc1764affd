"""One GLB file holds two motions of one body: the true one, and a translucent ghost of the other."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import accessor, read_glb

from neuroanimator import Clip, load_system, write_glb
from neuroanimator.errors import ArgumentError
from neuroanimator.export.gltf import GHOST_OPACITY
from neuroanimator.systems.rotation import rotation_matrices


def two_motions(name: str) -> tuple[Clip, Clip]:
    system, times = load_system(name), np.arange(11) / 30
    sway = np.linspace(0, 0.05, 11)[:, None]
    return tuple(
        Clip(name, system.skeleton, times[:frames], (system.rest + share * sway)[:frames])
        for frames, share in ((11, 1.0), (8, 2.0))
    )


@pytest.mark.parametrize("name", ["pendulum", "truck", "fish"])
def test_a_ghost_is_the_same_body_moving_its_own_way_and_translucent(name: str, tmp_path: Path):
    clip, ghost = two_motions(name)
    write_glb(clip, tmp_path / "a.glb", ghost=ghost)
    document, binary = read_glb(tmp_path / "a.glb")
    roots = [i for i, node in enumerate(document["nodes"]) if node["name"] in (name, f"ghost {name}")]
    assert {*document["scenes"][0]["nodes"]} >= {*roots}
    for motion, root in zip((clip, ghost), roots, strict=True):
        places, turns = motion.skeleton.local_poses(motion.states)
        tracks = {"translation": places, "rotation": turns[..., [1, 2, 3, 0]]}
        channels = [
            c for c in document["animations"][0]["channels"] if 0 < c["target"]["node"] - root <= places.shape[1]
        ]
        assert channels
        for channel in channels:
            sampler = document["animations"][0]["samplers"][channel["sampler"]]
            node, path = channel["target"]["node"], channel["target"]["path"]
            wanted = tracks[path][:, node - root - 1]
            found = accessor(document, binary, sampler["output"])
            signs = np.sign((wanted * found).sum(axis=1, keepdims=True)) if path == "rotation" else 1
            np.testing.assert_allclose(found * signs, wanted, atol=1e-6)
            np.testing.assert_allclose(accessor(document, binary, sampler["input"])[:, 0], motion.times, atol=1e-6)


@pytest.mark.parametrize("name", ["pendulum", "truck", "fish"])
def test_a_ghost_shares_its_shapes_and_only_its_materials_are_translucent(name: str, tmp_path: Path):
    clip, ghost = two_motions(name)
    write_glb(clip, tmp_path / "alone.glb")
    write_glb(clip, tmp_path / "a.glb", ghost=ghost)
    document, _ = read_glb(tmp_path / "a.glb")
    half = len(document["meshes"]) // 2
    for one, other in zip(document["meshes"][:half], document["meshes"][half:], strict=True):
        assert other["name"] == f"ghost {one['name']}"
        for solid, thin in zip(one["primitives"], other["primitives"], strict=True):
            assert (solid["attributes"], solid["indices"]) == (thin["attributes"], thin["indices"])
            first, second = (document["materials"][each["material"]] for each in (solid, thin))
            opacity = [m["pbrMetallicRoughness"]["baseColorFactor"][3] for m in (first, second)]
            assert opacity[1] == pytest.approx(GHOST_OPACITY * opacity[0])
            assert second["alphaMode"] == "BLEND"
            assert ("alphaMode" in first) == (opacity[0] < 1)
    alone, both = ((tmp_path / f).stat().st_size for f in ("alone.glb", "a.glb"))
    assert both < 1.8 * alone


def test_a_ghosts_skin_hangs_on_its_own_bones(tmp_path: Path):
    clip, ghost = two_motions("fish")
    write_glb(clip, tmp_path / "a.glb", ghost=ghost)
    document, binary = read_glb(tmp_path / "a.glb")
    nodes, skins = document["nodes"], document["skins"]
    assert [nodes[skin["skeleton"]]["name"] for skin in skins] == ["fish", "ghost fish"]
    for node in nodes:
        if "skin" in node:
            skin = skins[node["skin"]]
            assert skin["joints"] == nodes[skin["skeleton"]]["children"]
            assert node["name"].startswith("ghost ") == nodes[skin["skeleton"]]["name"].startswith("ghost ")
    matrices = accessor(document, binary, skins[1]["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
    bone = clip.skeleton.bones[2]
    np.testing.assert_allclose(matrices[2, :3, :3] @ rotation_matrices(np.array(bone.turn)), np.eye(3), atol=1e-6)


def test_a_ghost_of_another_body_is_refused(tmp_path: Path):
    with pytest.raises(ArgumentError, match="ghost: wanted another motion of the same body, came truck beside fish"):
        write_glb(two_motions("fish")[0], tmp_path / "a.glb", ghost=two_motions("truck")[0])
    assert not list(tmp_path.iterdir())
