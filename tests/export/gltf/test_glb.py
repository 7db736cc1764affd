"""What a GLB file says besides poses: light, names, what it is of, several bodies, scenery once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import accessor, read_glb

from neuroanimator import Clip, load_system, write_glb
from neuroanimator.appearance.colour import linear_of
from neuroanimator.errors import ArgumentError

SYSTEMS = ("pendulum", "truck", "lander", "fish", "dolphin", "cube")


def a_clip(name: str, shift: float = 0.0) -> Clip:
    """Return a made-up motion of eleven images, `shift` [m] along X."""
    system, times = load_system(name), np.arange(11) / 30
    states = system.rest + np.linspace(0, 0.05, 11)[:, None]
    if system.structure.cloud is not None:
        states[:, : 3 * system.structure.cloud.count : 3] += shift
    else:
        states[:, 0] += shift
    return Clip(name, system.skeleton, times, states, source="physics")


def meshes_in_use(document: dict) -> list[dict]:
    return [document["meshes"][node["mesh"]] for node in document["nodes"] if "mesh" in node]


def test_light_rises_with_a_colour_and_is_known_where_the_standard_says():
    assert (np.diff(linear_of(np.linspace(0, 1, 256))) > 0).all()
    assert linear_of(0.5) == pytest.approx(0.21404114)  # IEC 61966-2-1
    assert linear_of([0.0, 0.04045, 1.0]) == pytest.approx([0.0, 0.0031308, 1.0], abs=1e-6)


@pytest.mark.parametrize("name", ["pendulum", "truck", "lander"])
def test_a_materials_colour_is_the_light_of_the_colour_on_the_screen(name: str, tmp_path: Path):
    clip = a_clip(name)
    write_glb(clip, tmp_path / "a.glb")
    document, _ = read_glb(tmp_path / "a.glb")
    found = {tuple(m["pbrMetallicRoughness"]["baseColorFactor"]) for m in document["materials"]}
    shapes = [shape for bone in clip.skeleton.bones for shape in bone.shapes]
    wanted = {
        (*(round(float(c), 6) for c in linear_of(shape.colour[:3])), shape.colour[3])
        for shape in shapes
    }
    assert found == wanted


@pytest.mark.parametrize("name", ["truck", "lander"])
def test_a_textured_floor_has_the_mean_of_its_texture_and_is_not_white(name: str, tmp_path: Path):
    write_glb(a_clip(name), tmp_path / "a.glb")
    document, _ = read_glb(tmp_path / "a.glb")
    (floor,) = [m for m in document["materials"] if m["name"] == "floor"]
    light = np.array(floor["pbrMetallicRoughness"]["baseColorFactor"][:3])
    assert (light > linear_of(0.3)).all()
    assert (light < linear_of(0.6)).all()


def test_a_skins_points_are_as_bright_as_its_definition_says(tmp_path: Path):
    clip = a_clip("dolphin")
    write_glb(clip, tmp_path / "a.glb")
    document, binary = read_glb(tmp_path / "a.glb")
    (mesh,) = meshes_in_use(document)
    colours = accessor(document, binary, mesh["primitives"][0]["attributes"]["COLOR_0"])
    np.testing.assert_allclose(colours.max(axis=0).max(), linear_of(0.93), atol=0.05)
    darkest = colours.min(axis=0)
    assert (darkest >= linear_of(0.015)).all()
    assert (darkest <= linear_of(0.055)).all()


@pytest.mark.parametrize("name", SYSTEMS)
def test_everything_has_a_name_and_no_two_nodes_or_materials_share_one(name: str, tmp_path: Path):
    write_glb(a_clip(name), tmp_path / "a.glb", ghost=a_clip(name, 0.5))
    document, _ = read_glb(tmp_path / "a.glb")
    for kind in ("nodes", "materials"):
        names = [each["name"] for each in document[kind]]
        assert all(names)
        assert len({*names}) == len(names), f"{kind}: {sorted(names)}"
    assert all(mesh["name"] for mesh in document["meshes"])


def test_a_swimmers_parts_are_primitives_with_materials_of_their_names(tmp_path: Path):
    write_glb(a_clip("fish"), tmp_path / "a.glb")
    document, binary = read_glb(tmp_path / "a.glb")
    (mesh,) = meshes_in_use(document)
    names = [
        document["materials"][primitive["material"]]["name"] for primitive in mesh["primitives"]
    ]
    assert names == ["body", "fin", "eye"]
    triangles = [
        accessor(document, binary, primitive["indices"]).reshape(-1, 3)
        for primitive in mesh["primitives"]
    ]
    whole = {tuple(row) for part in triangles for row in part.tolist()}
    assert len(whole) == sum(len(part) for part in triangles)


def test_the_file_says_what_it_is_of(tmp_path: Path):
    write_glb(a_clip("cube"), tmp_path / "a.glb")
    document, _ = read_glb(tmp_path / "a.glb")
    assert document["asset"]["generator"].startswith("NeuroAnimator ")
    assert document["asset"]["extras"] == {"units": "m", "rate": pytest.approx(30)}
    (root,) = [node for node in document["nodes"] if "extras" in node]
    assert root["extras"] == {
        "system": "cube",
        "seconds": pytest.approx(1 / 3),
        "source": "physics",
        "units": "m",
        "rate": pytest.approx(30),
    }


@pytest.mark.parametrize("name", ["truck", "fish"])
def test_several_bodies_keep_their_places_and_motions_and_share_scenery_and_shapes(
    name: str, tmp_path: Path
):
    clips = [a_clip(name, shift) for shift in (0.0, 2.0, 4.0)]
    write_glb(clips, tmp_path / "a.glb")
    write_glb(clips[0], tmp_path / "alone.glb")
    document, binary = read_glb(tmp_path / "a.glb")
    alone, _ = read_glb(tmp_path / "alone.glb")
    assert document["meshes"] == alone["meshes"]
    assert document["materials"] == alone["materials"]
    names = [node["name"] for node in document["nodes"]]
    channels = document["animations"][0]["channels"]
    for number, clip in enumerate(clips):
        moving = next(i for i, bone in enumerate(clip.skeleton.bones) if bone.is_moving)
        title = f"{name} {number + 1} {clip.skeleton.bones[moving].name}"
        node = names.index(title.replace(" ", "_") if clip.skeleton.skin else title)
        (channel,) = [c for c in channels if c["target"] == {"node": node, "path": "translation"}]
        track = accessor(
            document, binary, document["animations"][0]["samplers"][channel["sampler"]]["output"]
        )
        np.testing.assert_allclose(
            track, clip.skeleton.local_poses(clip.states)[0][:, moving], atol=1e-5
        )
    first = clips[0].skeleton
    scenery = [
        bone.name for i, bone in enumerate(first.bones) if bone.shapes and not first.is_moved(i)
    ]
    drawn = [node["name"] for node in document["nodes"] if "mesh" in node]
    for bone in scenery:
        assert [each for each in drawn if each.endswith(f" {bone}")] == [f"{name} 1 {bone}"]


def test_no_clips_and_a_ghost_beside_several_are_refused(tmp_path: Path):
    clip = a_clip("cube")
    with pytest.raises(ArgumentError, match="wanted 1 to 1000 in one file, got 0"):
        write_glb([], tmp_path / "a.glb")
    with pytest.raises(ArgumentError, match="ghost: wanted another motion of the same body"):
        write_glb([clip, clip], tmp_path / "a.glb", ghost=clip)
    assert not list(tmp_path.iterdir())
