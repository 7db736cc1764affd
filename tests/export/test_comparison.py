"""One GLB file holds two motions of one body: the true one, and a translucent ghost of the other."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import accessor, read_glb

from neuroanimator import Clip, load_system, write_glb
from neuroanimator.appearance.colour import linear_of
from neuroanimator.errors import ArgumentError
from neuroanimator.export.ghost import GHOST_COLOUR, GHOST_OPACITY
from neuroanimator.state.rotation import rotation_matrices


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
    roots = roots_of(document, name)
    assert {*document["scenes"][0]["nodes"]} >= {*roots}
    for motion, root in zip((clip, ghost), roots, strict=True):
        positions, orientations = motion.skeleton.local_poses(motion.states)
        tracks = {"translation": positions, "rotation": orientations[..., [1, 2, 3, 0]]}
        channels = [
            c
            for c in document["animations"][0]["channels"]
            if 0 < c["target"]["node"] - root <= positions.shape[1]
        ]
        assert channels
        for channel in channels:
            sampler = document["animations"][0]["samplers"][channel["sampler"]]
            node, path = channel["target"]["node"], channel["target"]["path"]
            wanted = tracks[path][:, node - root - 1]
            found = accessor(document, binary, sampler["output"])
            signs = (
                np.sign((wanted * found).sum(axis=1, keepdims=True)) if path == "rotation" else 1
            )
            np.testing.assert_allclose(found * signs, wanted, atol=1e-6)
            np.testing.assert_allclose(
                accessor(document, binary, sampler["input"])[:, 0], motion.times, atol=1e-6
            )


@pytest.mark.parametrize("name", ["pendulum", "truck", "lander", "fish"])
def test_a_ghost_is_only_what_moves_in_one_other_colour_and_shares_its_shapes(
    name: str, tmp_path: Path
):
    clip, ghost = two_motions(name)
    write_glb(clip, tmp_path / "alone.glb")
    write_glb(clip, tmp_path / "a.glb", ghost=ghost)
    document, _ = read_glb(tmp_path / "a.glb")
    used = {"solid": set(), "ghost": set()}
    shapes: dict[str, list] = {"solid": [], "ghost": []}
    for node in document["nodes"]:
        kind = "ghost" if node["name"].startswith("ghost") else "solid"
        for primitive in document["meshes"][node["mesh"]]["primitives"] if "mesh" in node else []:
            used[kind].add(primitive["material"])
            shapes[kind].append((primitive["attributes"]["POSITION"], primitive["indices"]))
    (thin,) = used["ghost"]
    assert thin not in used["solid"]
    colour = document["materials"][thin]["pbrMetallicRoughness"]["baseColorFactor"]
    assert colour == pytest.approx([*linear_of(GHOST_COLOUR), GHOST_OPACITY], abs=1e-5)
    assert document["materials"][thin]["alphaMode"] == "BLEND"
    assert {*shapes["ghost"]} <= {*shapes["solid"]}
    scenery = sum(
        len(b.shapes) for i, b in enumerate(clip.skeleton.bones) if not clip.skeleton.is_moved(i)
    )
    assert len(shapes["solid"]) - len(shapes["ghost"]) == scenery
    alone, both = ((tmp_path / f).stat().st_size for f in ("alone.glb", "a.glb"))
    assert both < 1.8 * alone


def roots_of(document: dict, name: str) -> list[int]:
    """Return the nodes that turn the true body and its ghost."""
    names = [node["name"].replace("_", " ") for node in document["nodes"]]
    return [names.index(f"{name} root"), names.index(f"ghost {name} root")]


def test_a_ghosts_skin_hangs_on_its_own_bones(tmp_path: Path):
    clip, ghost = two_motions("fish")
    write_glb(clip, tmp_path / "a.glb", ghost=ghost)
    document, binary = read_glb(tmp_path / "a.glb")
    nodes, skins = document["nodes"], document["skins"]
    assert [nodes[skin["skeleton"]]["name"] for skin in skins] == ["fish_root", "ghost_fish_root"]
    for node in nodes:
        if "skin" in node:
            skin = skins[node["skin"]]
            root = nodes[skin["skeleton"]]
            assert skin["joints"] == [skin["skeleton"], *root["children"]]
            assert node["name"].startswith("ghost") == root["name"].startswith("ghost")
    matrices = (
        accessor(document, binary, skins[1]["inverseBindMatrices"])
        .reshape(-1, 4, 4)
        .transpose(0, 2, 1)
    )
    bone = clip.skeleton.bones[2]
    np.testing.assert_allclose(
        matrices[1 + 2, :3, :3] @ rotation_matrices(np.array(bone.orientation)),
        np.eye(3),
        atol=1e-6,
    )


def test_a_ghost_of_another_body_is_refused(tmp_path: Path):
    with pytest.raises(
        ArgumentError, match="ghost: wanted another motion of the same body, got truck for fish"
    ):
        write_glb(two_motions("fish")[0], tmp_path / "a.glb", ghost=two_motions("truck")[0])
    assert not list(tmp_path.iterdir())
