"""A GLB file in three.js: the loader, its animation and its pictures show the surface that the states have."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from chromium import browsing, hosting, looking
from PIL import Image
from playwright.sync_api import Page
from soft_bodies import soft_clip, wavy_shapes

from neuroanimator import write_glb
from neuroanimator.export.morphs import TOLERANCE, surface_normals

THREE = Path(__file__).parents[3] / "studio" / "node_modules" / "three"
"""What the studio's page is built with."""

VIEWER = """<!doctype html>
<link rel="icon" href="data:,">
<style>body { margin: 0 }</style>
<script type="importmap">{"imports": {"three": "./three/build/three.module.js"}}</script>
<script type="module">
import * as THREE from "three";
import { GLTFLoader } from "./three/examples/jsm/loaders/GLTFLoader.js";

const renderer = new THREE.WebGLRenderer({ preserveDrawingBuffer: true });
renderer.setSize(innerWidth, innerHeight);
document.body.append(renderer.domElement);
const file = await new GLTFLoader().loadAsync("./a.glb");
const scene = new THREE.Scene();
scene.background = new THREE.Color("white");
scene.add(file.scene, new THREE.HemisphereLight("white", "gray", 3));
const mixer = new THREE.AnimationMixer(file.scene);
for (const clip of file.animations) {
  mixer.clipAction(clip).play();
}
let surface;
file.scene.traverse((node) => { if (node.morphTargetInfluences) surface = node; });

function morphedNormals() {
  const { normal } = surface.geometry.attributes;
  const changes = surface.geometry.morphAttributes.normal;
  const turn = new THREE.Matrix3().getNormalMatrix(surface.matrixWorld);
  const found = [];
  for (let node = 0; node < normal.count; node++) {
    const sum = new THREE.Vector3().fromBufferAttribute(normal, node);
    changes.forEach((change, number) => {
      const by = new THREE.Vector3().fromBufferAttribute(change, node);
      sum.addScaledVector(by, surface.morphTargetInfluences[number]);
    });
    found.push(sum.applyMatrix3(turn).normalize().toArray());
  }
  return found;
}

// Points and normals of all nodes at so many seconds, and the picture from a place, Y up.
window.show = (seconds, eye, middle) => {
  mixer.setTime(seconds);
  file.scene.updateMatrixWorld(true);
  const points = [];
  for (let node = 0; node < surface.geometry.attributes.position.count; node++) {
    const point = surface.getVertexPosition(node, new THREE.Vector3());
    points.push(point.applyMatrix4(surface.matrixWorld).toArray());
  }
  const camera = new THREE.PerspectiveCamera(40, innerWidth / innerHeight, 0.01, 100);
  camera.position.set(...eye);
  camera.lookAt(...middle);
  renderer.render(scene, camera);
  return { points, normals: morphedNormals(), colour: surface.material.color.toArray() };
};
window.isReady = true;
</script>
"""


@contextmanager
def viewing(folder: Path) -> Iterator[Page]:
    """Open a page that shows the file `a.glb` of a folder."""
    if not THREE.is_dir():
        pytest.skip("three.js is not installed: make page")
    (folder / "three").symlink_to(THREE)
    (folder / "index.html").write_text(VIEWER)
    with browsing() as browser, hosting(folder) as address, looking(browser) as look:
        look.page.goto(address)
        look.page.wait_for_function("window.isReady")
        yield look.page
        assert look.complaints == []


def upright(vectors: np.ndarray) -> np.ndarray:
    """Return Y-up vectors with Z up."""
    return np.stack([vectors[..., 0], -vectors[..., 2], vectors[..., 1]], axis=-1)


def test_three_shows_nodes_and_normals_where_the_states_have_them(tmp_path: Path):
    clip = soft_clip(wavy_shapes(turns=True))
    shapes = clip.skeleton.shapes
    assert shapes is not None
    write_glb(clip, tmp_path / "a.glb")
    frames = [0, 7, len(clip.times) - 2]  # at the very end the loop begins anew
    middle = shapes.decode(clip.states).mean(axis=(0, 1))
    eye = middle + np.array([0.3, -2.5, 0.5])
    places = [[x, z, -y] for x, y, z in (eye.tolist(), middle.tolist())]
    told = []
    with viewing(tmp_path) as page:
        for frame in frames:
            told.append(page.evaluate("of => show(...of)", [clip.times[frame], *places]))
        content = page.screenshot()
    points = upright(np.array([one["points"] for one in told]))
    truth = shapes.decode(clip.states[frames])
    away = np.sqrt(((points - truth) ** 2).sum(axis=2).mean(axis=1))
    assert away.max() <= 1.1 * TOLERANCE * np.ptp(truth, axis=1).max()
    normals = upright(np.array([one["normals"] for one in told]))
    along = (normals * surface_normals(shapes, truth)).sum(axis=2)
    assert np.degrees(np.arccos(np.median(along))) < 5
    picture = np.asarray(Image.open(io.BytesIO(content)).convert("RGB")).astype(int)
    is_red = picture[..., 0] - picture[..., 1:].max(axis=2) > 40
    assert is_red.mean() > 0.05
    assert told[0]["colour"][0] > 2 * told[0]["colour"][1]
