"""The surface of a soft body in a GLB file: morph targets bring its nodes and normals where the states have them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import accessor, read_glb
from soft_bodies import distances, soft_clip, wavy_shapes

from neuroanimator import Clip, load_emulator, write_glb
from neuroanimator.appearance.colour import linear_of
from neuroanimator.appearance.shapes import Shapes
from neuroanimator.export.morphs import TOLERANCE, surface_normals
from neuroanimator.state.rotation import rotate

MAX_FILE = 2_000_000
"""Maximum size of five seconds of a cape of 5,000 nodes with 96 shapes [bytes]."""


@pytest.fixture(scope="module")
def shapes() -> Shapes:
    return wavy_shapes()


class Drawn:
    """A GLB file as a viewer has it: points and normals of its surfaces in every frame, Z up."""

    def __init__(self, path: Path):
        self.document, self.binary = read_glb(path)
        animation = self.document["animations"][0]
        self.tracks = {}
        for channel in animation["channels"]:
            target = channel["target"]
            output = animation["samplers"][channel["sampler"]]["output"]
            self.tracks[target["node"], target["path"]] = self.array(output)

    def array(self, number: int) -> np.ndarray:
        return accessor(self.document, self.binary, number).astype(float)

    @property
    def surfaces(self) -> list[int]:
        nodes = enumerate(self.document["nodes"])
        return [number for number, node in nodes if node["name"].endswith("surface")]

    def mesh(self, node: int) -> dict:
        return self.document["meshes"][self.document["nodes"][node]["mesh"]]

    def decode(self, node: int, attribute: str, frames: int) -> np.ndarray:
        (primitive,) = self.mesh(node)["primitives"]
        targets = primitive.get("targets", [])
        base = self.array(primitive["attributes"][attribute])
        if not targets:
            return np.repeat(base[None], frames, axis=0)
        deltas = np.stack([self.array(target[attribute]) for target in targets])
        weights = self.tracks[node, "weights"].reshape(frames, len(targets))
        return base + np.tensordot(weights, deltas, axes=1)

    def nodes(self, node: int, frames: int) -> np.ndarray:
        scale = np.array(self.document["nodes"][node]["scale"])
        points = scale * self.decode(node, "POSITION", frames)
        if (node, "rotation") in self.tracks:
            wxyz = self.tracks[node, "rotation"][:, [3, 0, 1, 2]]
            points = rotate(np.repeat(wxyz[:, None], points.shape[1], axis=1), points)
        return points + self.tracks[node, "translation"][:, None]


@pytest.mark.parametrize("turns", [False, True])
def test_the_glb_has_every_node_where_the_states_have_it_in_every_frame(
    turns: bool, tmp_path: Path
):
    shapes = wavy_shapes(turns=turns)
    clip = soft_clip(shapes)
    write_glb(clip, tmp_path / "a.glb")
    drawn = Drawn(tmp_path / "a.glb")
    (node,) = drawn.surfaces
    stated = drawn.mesh(node)["extras"]["error"]
    found = distances(drawn.nodes(node, len(clip.times)), clip)
    size = np.ptp(shapes.decode(clip.states), axis=1).max()
    assert found.max() <= 1.1 * stated
    assert stated <= TOLERANCE * size
    assert drawn.document["extensionsRequired"] == ["KHR_mesh_quantization"]
    assert drawn.document["materials"][-1]["doubleSided"]


@pytest.mark.parametrize("seed", range(6))
def test_all_weights_stay_between_0_and_1(seed: int, shapes: Shapes, tmp_path: Path):
    """Blender cuts off what is beyond in later frames than the first, gltfpack in all."""
    write_glb(soft_clip(shapes, frames=8 + 5 * seed, seed=seed), tmp_path / "a.glb")
    drawn = Drawn(tmp_path / "a.glb")
    (node,) = drawn.surfaces
    names = drawn.mesh(node)["extras"]["targetNames"]
    assert {name.split()[0] for name in names} == {"shape", "normals"}
    weights = drawn.tracks[node, "weights"]
    assert weights.min() >= 0
    assert weights.max() <= 1


def test_without_targets_a_surface_has_its_mean_shape(shapes: Shapes, tmp_path: Path):
    clip = soft_clip(shapes)
    write_glb(clip, tmp_path / "a.glb")
    drawn = Drawn(tmp_path / "a.glb")
    (node,) = drawn.surfaces
    (primitive,) = drawn.mesh(node)["primitives"]
    points = (
        drawn.array(primitive["attributes"]["POSITION"]) * drawn.document["nodes"][node]["scale"]
    )
    own = shapes.decode(clip.states) - clip.states[:, None, :3]
    assert np.abs(points - own.mean(axis=0)).max() < 1e-6
    normals = drawn.array(primitive["attributes"]["NORMAL"])
    assert np.abs(normals - surface_normals(shapes, points)).max() < 1e-4


@pytest.mark.parametrize("is_by_frame", [False, True])
def test_normals_in_the_glb_follow_the_surface(is_by_frame: bool, shapes: Shapes, tmp_path: Path):
    """Also where an engine keeps the normals that each target leads to, with length 1, instead of changes."""
    clip = soft_clip(shapes)
    write_glb(clip, tmp_path / "a.glb")
    drawn = Drawn(tmp_path / "a.glb")
    (node,) = drawn.surfaces
    normals = drawn.decode(node, "NORMAL", len(clip.times))
    if is_by_frame:
        (primitive,) = drawn.mesh(node)["primitives"]
        base = drawn.array(primitive["attributes"]["NORMAL"])
        ends = base + [drawn.array(target["NORMAL"]) for target in primitive["targets"]]
        ends /= np.linalg.norm(ends, axis=2, keepdims=True)
        weights = drawn.tracks[node, "weights"].reshape(len(clip.times), -1)
        normals = base + np.tensordot(weights, ends - base, axes=1)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    expected = surface_normals(shapes, shapes.decode(clip.states))
    angles = np.degrees(np.arccos(np.clip((normals * expected).sum(axis=2), -1, 1)))
    assert np.sqrt((angles**2).mean()) < 5


def test_every_number_of_the_file_is_written(shapes: Shapes, tmp_path: Path):
    """The format lets zeros be left out; Assimp then refuses the file."""
    write_glb(soft_clip(shapes), tmp_path / "a.glb")
    document, _ = read_glb(tmp_path / "a.glb")
    assert all("bufferView" in numbers for numbers in document["accessors"])


def test_five_seconds_of_a_cape_are_a_small_file(tmp_path: Path):
    """Even where every shape swings alike: what does not fit is left out, and the file says how much that is."""
    flag = wavy_shapes(71, 4)
    count = flag.mean.size
    turns = np.arange(1, 97)[:, None] * np.arange(count) / count
    modes = np.sqrt(2 / 3) * np.cos(2 * np.pi * turns).reshape(96, -1, 3)
    clip = soft_clip(replace(flag, modes=modes), frames=151, decay=0.0)
    path = tmp_path / "a.glb"
    write_glb(clip, path)
    assert path.stat().st_size <= MAX_FILE
    drawn = Drawn(path)
    found = distances(drawn.nodes(drawn.surfaces[0], 151), clip)
    assert found.max() <= 1.1 * drawn.mesh(drawn.surfaces[0])["extras"]["error"]


def test_a_school_and_a_ghost_share_the_targets_and_keep_their_motions(
    shapes: Shapes, tmp_path: Path
):
    clips = [soft_clip(shapes, seed=0), soft_clip(shapes, frames=30, seed=1)]
    write_glb(clips, tmp_path / "school.glb")
    write_glb(clips[0], tmp_path / "ghost.glb", ghost=clips[1])
    for name in ("school", "ghost"):
        drawn = Drawn(tmp_path / f"{name}.glb")
        for node, clip in zip(drawn.surfaces, clips, strict=True):
            found = distances(drawn.nodes(node, len(clip.times)), clip)
            assert found.max() <= 1.1 * drawn.mesh(node)["extras"]["error"]
        targets = [drawn.mesh(node)["primitives"][0]["targets"] for node in drawn.surfaces]
        assert targets[0] == targets[1]
        materials = [drawn.mesh(node)["primitives"][0]["material"] for node in drawn.surfaces]
        assert len({*materials}) == (2 if name == "ghost" else 1)


def test_a_surface_that_keeps_its_shape_has_no_targets(shapes: Shapes, tmp_path: Path):
    clip = soft_clip(shapes, frames=3)
    states = clip.states.copy()
    states[:, 3:] = states[0, 3:]
    still = replace(clip, states=states)
    write_glb(still, tmp_path / "a.glb")
    drawn = Drawn(tmp_path / "a.glb")
    assert "targets" not in drawn.mesh(drawn.surfaces[0])["primitives"][0]
    assert distances(drawn.nodes(drawn.surfaces[0], 3), still).max() < 1e-6


def test_flesh_has_the_colours_of_its_nodes_and_its_ghost_has_none(tmp_path: Path):
    emulator = load_emulator("trout")
    states = np.repeat(emulator.rest[None], 3, axis=0)
    clip = Clip("trout", emulator.skeleton, np.arange(3) / 30, states)
    write_glb(clip, tmp_path / "a.glb", ghost=clip)
    drawn = Drawn(tmp_path / "a.glb")
    flesh, ghost = (drawn.mesh(node)["primitives"][0]["attributes"] for node in drawn.surfaces)
    expected = linear_of(emulator.skeleton.shapes.colours)
    np.testing.assert_allclose(drawn.array(flesh["COLOR_0"]), expected, atol=1e-6)
    assert "COLOR_0" not in ghost
