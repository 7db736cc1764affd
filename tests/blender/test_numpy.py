"""An .npz file runs in NumPy alone, without this package, and does what its emulator does; hostile ones are refused."""

from __future__ import annotations

import io
import json
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import numpy_runtime
import pytest
from npz_file import write_npz

from neuroanimator import load_emulator, load_policy

RUNTIME = str(Path(numpy_runtime.__file__).parent)

ALONE = """
import sys
import numpy as np
from numpy_runtime import load
assert "neuroanimator" not in sys.modules and "jax" not in sys.modules
fish, swim = load("fish.npz"), load("swim.npz")
state, phase, controls = fish.rest, 0.0, []
for _ in range(20):
    control = swim.control(state, phase, [0.1, 0.2, 0.0, 0.0])
    state = fish.step(state, control)
    phase += swim.facts["phase_per_step"]
    controls.append(control)
states = fish.rollout(fish.rest, controls)
assert np.array_equal(states[-1], state)
assert fish.step(np.stack([state, fish.rest]), np.stack([control, control])).shape == (2, len(state))
following, scores = fish.step_trusted(states[:-1], np.stack(controls))
assert np.allclose(following, states[1:], atol=1e-5)
assert np.isclose(scores[-1], fish.trust(states[-2], control), rtol=1e-3)
np.savez("found.npz", states=states, controls=controls, scores=scores)
"""


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("numpy")
    write_npz(load_emulator("fish-50"), folder / "fish.npz", "Apache-2.0")
    write_npz(load_policy("fish"), folder / "swim.npz")
    return folder


def test_a_motion_alone_is_the_emulators(written: Path):
    command = [sys.executable, "-I", "-c", f"import sys; sys.path.insert(0, {RUNTIME!r})" + ALONE]
    subprocess.run(command, cwd=written, check=True, capture_output=True)
    found = np.load(written / "found.npz")
    fish = load_emulator("fish-50")
    expected = [fish.rest]
    for control in found["controls"]:
        expected.append(fish.step(expected[-1], control))
    np.testing.assert_allclose(found["states"], expected, atol=1e-4)
    assert np.abs(expected[-1] - expected[0]).max() > 0.05  # it swam
    scores = fish.trust(found["states"][:-1], found["controls"])
    np.testing.assert_allclose(found["scores"], scores, rtol=1e-3, atol=1e-3)


def test_the_same_model_is_the_same_bytes_and_says_what_draws_it(written: Path, tmp_path: Path):
    emulator = load_emulator("fish-50")
    again = tmp_path / "fish.npz"
    write_npz(emulator, again, "Apache-2.0")
    assert again.read_bytes() == (written / "fish.npz").read_bytes()
    fish = numpy_runtime.load(again)
    assert fish.facts["licence"] == "Apache-2.0"
    assert len(fish.body["bones"]) == len(emulator.spec.skeleton.bones)
    assert fish.arrays["skin_triangles"].max() < len(fish.arrays["skin_points"])


def hostile(written: Path, **changes: object) -> io.BytesIO:
    """Return the file with other things in its program."""
    with np.load(written / "fish.npz") as content:
        arrays = dict(content)
    told = json.loads(bytes(arrays["program"])) | changes
    text = json.dumps(told).encode()
    file = io.BytesIO()
    np.savez(file, **(arrays | {"program": np.frombuffer(text, np.uint8)}))
    file.seek(0)
    return file


@pytest.mark.attack
@pytest.mark.parametrize(
    "changes",
    [
        {"nodes": [["__import__", ["state"], "next_state", []]]},
        {"nodes": [["Add", ["state", "unknown"], "next_state", []]]},
        {"nodes": [["Identity", ["state"], "another", []]]},
        {"nodes": [["Identity", ["state"], "next_state", []]] * (numpy_runtime.MAX_NODES + 1)},
        {"nodes": 3},
        {"format": "another"},
        {"constants": ["../../etc/passwd"]},
    ],
)
def test_a_strange_program_is_refused(changes: dict, written: Path):
    with pytest.raises(
        ValueError, match="wanted|no operator|nothing computes|not a NeuroAnimator file"
    ):
        numpy_runtime.load(hostile(written, **changes))


@pytest.mark.attack
def test_a_damaged_file_is_refused_wherever_it_is_cut_or_changed(written: Path):
    whole = (written / "fish.npz").read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(60):
        content = bytearray(whole[: rng.integers(0, len(whole))] if rng.random() < 0.5 else whole)
        for place in rng.integers(0, max(1, len(content)), 4):
            content[place : place + 1] = bytes([rng.integers(256)])
        try:
            numpy_runtime.load(io.BytesIO(bytes(content)))
        except ValueError:
            continue


@pytest.mark.attack
def test_few_bytes_that_stand_for_many_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(numpy_runtime, "MAX_SIZE", 1 << 20)
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("program.npy", bytes(numpy_runtime.MAX_SIZE + 1))
    with pytest.raises(ValueError, match="wanted at most"):
        numpy_runtime.load(path)


@pytest.mark.attack
def test_a_pickle_is_never_opened(tmp_path: Path):
    path = tmp_path / "evil.npz"
    np.savez(path, program=np.array([object()], dtype=object))
    with pytest.raises(ValueError, match="allow_pickle=False"):
        numpy_runtime.load(path)
