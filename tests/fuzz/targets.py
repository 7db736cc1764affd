"""Every parser of strangers' files as a function of bytes, which returns or raises a NeuroAnimatorError."""

from __future__ import annotations

import base64
import json
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from characters import write_character

from neuroanimator.animation.recorded_path import read_path
from neuroanimator.cli.usage import whole_numbers
from neuroanimator.control.synthesis.objective_file import read_objective
from neuroanimator.definitions.carried import TABLES
from neuroanimator.emulator.emulator import load_emulator
from neuroanimator.errors import NeuroAnimatorError
from neuroanimator.export.csv_file import read_table
from neuroanimator.export.gltf.buffers import glb_bytes
from neuroanimator.files.atomic import read_tensors, write_tensors
from neuroanimator.files.glb import read_glb
from neuroanimator.files.tables import check_table, read_toml
from neuroanimator.files.zoo import shipped_path
from neuroanimator.learn.data.config import DatasetConfig
from neuroanimator.learn.data.store import claim_folder, read_config, read_transitions
from neuroanimator.physics import load_system
from neuroanimator.physics.loading import LOADERS, from_text
from neuroanimator.physics.recorded.npz_file import read_npz
from neuroanimator.physics.recorded.recording import cut_runs, read_csv
from neuroanimator.physics.rigid.compiled_model import ModelRequest, compile_here
from neuroanimator.physics.soft.mesh_file import read_mesh
from neuroanimator.scaffold.character import propose_movers
from neuroanimator.state.layout import Layout, Slice
from neuroanimator.systems.model_files import ModelFiles
from neuroanimator.systems.system import System
from neuroanimator_studio.requests import read_request, request_id

FOLDER = Path(tempfile.mkdtemp(prefix="fuzz-"))

LAYOUT = Layout((Slice("angle", 2, "rad"), Slice("speed", 1, "rad/s")))

MODEL = """<mujoco><worldbody><body name="b"><joint name="j"/><geom size="1"/></body></worldbody>
<actuator><motor name="m" joint="j"/></actuator></mujoco>"""

FILES = {
    "main": "m.xml",
    "files": {"m.xml": base64.b64encode(MODEL.encode()).decode()},
    "name": "a.csv",
    "sha256": "0" * 64,
    "rows": [100],
    "origins": ["row 0"],
}
"""What travels with a definition, of every kind at once."""

MESSAGE = 1 << 20
"""[bytes] The longest message of the studio's page."""

FEW = 2
"""Runs in a dataset of the fuzzer's."""


def toml(content: bytes) -> None:
    """A definition of any kind."""
    values = read_toml(_file("a.toml", content))
    name = values.get("kind", "mujoco")
    if isinstance(name, str) and name in LOADERS:
        loader = LOADERS[name]
        loader.make(check_table(values, "a.toml", TABLES[name]), FILES, "")


def definition(content: bytes) -> None:
    """The text of a definition as datasets and emulators carry it."""
    from_text(content.decode("utf-8", "replace"))


def model(content: bytes) -> None:
    """MJCF or URDF."""
    files = ModelFiles("model.xml", (("model.xml", content),))
    compile_here(ModelRequest("model.xml", files.documents()))


def objective(content: bytes) -> None:
    """What a motion should achieve, in TOML."""
    read_objective(_file("a.toml", content), _system("lander"))


def csv(content: bytes) -> None:
    """Recordings as text."""
    cut_runs(read_csv(content, "a.csv"), "a.csv")


def npz(content: bytes) -> None:
    """Recordings as arrays."""
    cut_runs(read_npz(content, "a.npz"), "a.npz")


def clip(content: bytes) -> None:
    """A clip's table."""
    read_table(_file("a.csv", content), LAYOUT)


def path(content: bytes) -> None:
    """A mover's path as a table."""
    _file("walk.csv", content)
    read_path(FOLDER / "walk.csv")


def glb(content: bytes) -> None:
    """A character's document, about two keyframes at 0 and 1 s; or the whole file, where it is no JSON."""
    document = _json(content)
    if isinstance(document, dict):
        content = glb_bytes(document, np.arange(8, dtype="<f4").tobytes())
    _file("walk.glb", content)
    read_path(f"{FOLDER}/walk.glb:hips")


def rig(content: bytes) -> None:
    """The document of a character with a skin, about the numbers of a small one; or the whole file."""
    document = _json(content)
    if isinstance(document, dict):
        content = glb_bytes(document, _numbers_of_character())
    nodes = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.5]])
    propose_movers(_file("rig.glb", content), nodes, np.array([0]), 0.01)


def mesh(content: bytes) -> None:
    """A cloth's surface."""
    read_mesh("a.obj", content)


def solid(content: bytes) -> None:
    """A solid's tetrahedra."""
    read_mesh("a.msh", content)


def tensors(content: bytes) -> None:
    """The header of an emulator, policy, shard or checkpoint."""
    read_tensors(_file("a.safetensors", content), "emulator")


def config(content: bytes) -> None:
    """What a dataset says of itself."""
    _file("dataset.json", content)
    read_config(FOLDER)


def dataset(content: bytes) -> None:
    """A sealed shard: `{"tensors": {name: [dtype, shape, number]}, "metadata": {...}}` in JSON."""
    values = _json(content)
    folder = FOLDER / "dataset"
    settings = DatasetConfig(system="pendulum", count=FEW * 12)
    claim_folder(folder, settings)
    listed = values.get("tensors") if isinstance(values, dict) else None
    arrays = {}
    for name, row in list(listed.items())[:8] if isinstance(listed, dict) else ():
        try:
            dtype, shape, number = row
            if np.prod([float(length) for length in shape]) < 100_000:
                kind = {"F32": "f4", "F64": "f8", "I32": "i4"}[dtype]
                # What is too large for its kind becomes infinite, and NaN some whole number.
                with np.errstate(over="ignore", invalid="ignore"):
                    arrays[name] = np.full(shape, number, kind)
        except (ValueError, TypeError, KeyError, OverflowError):
            continue
    metadata = {"kind": "shard", "config": settings.hash, "shard": 0, "diverged": 0}
    given = values.get("metadata") if isinstance(values, dict) else None
    path = settings.shard_path(folder, 0)
    try:
        write_tensors(path, arrays, metadata | (given if isinstance(given, dict) else {}))
    except (ValueError, TypeError):
        return
    read_transitions(folder)


def emulator(content: bytes) -> None:
    """A sealed emulator of which parts of the metadata are replaced by those in JSON."""
    changes = _json(content)
    if not isinstance(changes, dict):
        return
    weights, metadata = _shipped()
    path = FOLDER / "a.emulator.safetensors"
    try:
        write_tensors(path, weights, metadata | changes)
    except ValueError:
        return
    load_emulator(path)


def state(content: bytes) -> None:
    """What a Python caller gives as a state."""
    LAYOUT.check(_json(content), "state")


def numbers(content: bytes) -> None:
    """A list of numbers on the command line."""
    whole_numbers("widths", content.decode("utf-8", "replace"))


def request(content: bytes) -> None:
    """A message of the studio's page; what is no JSON ends its connection."""
    text = content.decode("utf-8", "replace")
    try:
        request_id(text, MESSAGE)
    except ValueError:
        return
    read_request(text, MESSAGE)


TARGETS: dict[str, Callable[[bytes], None]] = {
    "clip": clip,
    "config": config,
    "csv": csv,
    "dataset": dataset,
    "definition": definition,
    "emulator": emulator,
    "glb": glb,
    "mesh": mesh,
    "model": model,
    "npz": npz,
    "numbers": numbers,
    "objective": objective,
    "path": path,
    "request": request,
    "rig": rig,
    "solid": solid,
    "state": state,
    "tensors": tensors,
    "toml": toml,
}


def try_parser(name: str, content: bytes) -> str:
    """Return what the parser refused `content` with, empty if it read it; any other error is the parser's fault."""
    try:
        TARGETS[name](content)
    except NeuroAnimatorError as error:
        message = str(error)
        assert "\n" not in message, "an error of several lines"
        assert len(message) < 2000, "an error of thousands of characters"
        return message
    return ""


def _file(name: str, content: bytes) -> Path:
    path = FOLDER / name
    path.write_bytes(content)
    return path


def _json(content: bytes) -> Any:
    try:
        return json.loads(content)
    except (ValueError, RecursionError):
        return None


@cache
def _numbers_of_character() -> bytes:
    return read_glb(write_character(FOLDER / "character.glb")).binary


@cache
def _system(name: str) -> System:
    return load_system(name)


@cache
def _shipped() -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    return read_tensors(shipped_path("pendulum"), "emulator")
