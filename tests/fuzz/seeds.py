"""Files the fuzzer starts from: what users have, small."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
from characters import write_character

import neuroanimator
from fuzz.corpus import read_corpus, write_corpus
from neuroanimator.files.atomic import read_tensors, write_tensors
from neuroanimator.files.glb import read_glb
from neuroanimator.files.zoo import shipped_path

ASSETS = Path(str(neuroanimator.__file__)).parent / "systems" / "assets"

JELLY = """name = "jelly"
kind = "mass-spring"
[physics]
step = 0.001
truth_step = 0.001
fine_step = 0.0001
[nodes]
a = [0.2, 0.0, 0.0, 0.1]
b = [0.0, 0.1, 0.0, 0.1]
c = [0.0, -0.1, 0.0, 0.1]
[springs.all]
stiffness = 50.0
damping = 0.05
pairs = [["a", "b"], ["b", "c"], ["c", "a"]]
[muscles]
shorten = 0.2
[muscles.springs]
pull = [["a", "b"]]
"""
STEP = """name = "tank"
kind = "recorded"
file = "runs.csv"
[physics]
step = 0.02
[[state]]
name = "angle"
unit = "rad"
feature = "sine"
[[control]]
name = "torque"
unit = "N·m"
low = [-1.0]
high = [1.0]
"""
FUNCTION = (
    STEP.replace('"recorded"', '"python"')
    .replace("runs.csv", "step.py")
    .replace("step = 0.02", "step = 0.02\ntruth_step = 0.02\nfine_step = 0.002")
)
OBJECTIVE = """system = "lander"
seconds = 2.0
parametrisation = "spline"
[[costs]]
kind = "reach_position"
position = [1, 2, 3]
within = 0.1
[[costs]]
kind = "avoid"
zones = [{ position = [0.2, 0], radius = 0.5 }]
margin = 1
[[costs]]
kind = "effort"
"""
RECORDING = """run,time s,state.angle rad,control.torque N·m
0,0.00,0.1,1
0,0.02,0.2,2
1,0.00,0.3,1
1,0.02,"0.2",2
"""
MODEL = """<mujoco><option timestep="0.01"/><worldbody><body name="b"><joint name="j" type="hinge"/>
<geom type="box" size="1 1 1"/></body></worldbody><actuator><motor joint="j"/></actuator></mujoco>"""
ROBOT = """<robot name="r"><link name="a"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0"
ixz="0" iyz="0"/></inertial></link></robot>"""

REQUESTS = {
    "replay": {"id": 1, "do": "replay", "bundle": "a", "start": [0.5, 1], "controls": [[0], [1e3]]},
    "judge": {
        "id": 2,
        "do": "judge",
        "bundle": "a",
        "goal": "pad",
        "target": [0, 1, 2],
        "states": "AAAA",
    },
    "train": {"id": 3, "do": "train", "system": "fish", "substeps": 50, "size": "sketch"},
    "stop": {"id": 4, "do": "stop", "job": "00"},
}


CHARACTER = {
    "nodes": [
        {"name": "root", "children": [1], "rotation": [0, 0, 0, 1], "scale": [1, 1, 1]},
        {"name": "hips", "translation": [0, 1, 0]},
    ],
    "animations": [
        {
            "channels": [{"sampler": 0, "target": {"node": 1, "path": "translation"}}],
            "samplers": [{"input": 0, "output": 1, "interpolation": "LINEAR"}],
        }
    ],
    "accessors": [
        {"bufferView": 0, "componentType": 5126, "count": 2, "type": "SCALAR"},
        {"bufferView": 1, "componentType": 5126, "count": 2, "type": "VEC3"},
    ],
    "bufferViews": [
        {"buffer": 0, "byteOffset": 0, "byteLength": 8},
        {"buffer": 0, "byteOffset": 8, "byteLength": 24},
    ],
    "buffers": [{"byteLength": 32}],
}
"""A character's document: two nodes, of which one goes along."""

SKIN = {
    "kind": "mesh",
    "bones": [{"number": 0, "position": [0, 0, 0], "orientation": [1, 0, 0, 0]}],
    "parts": [{"name": "a", "colour": [1, 0, 0], "triangles": 1}],
    "lowest": [0, 0, 0],
    "step": 3.0517578125e-05,
    "vertices": "zlib:eNpjYACDBgYYaAAABhIBAQ==",
    "triangles": "zlib:eNpjYGBkYGIAAAAOAAQ=",
    "influences": "zlib:eNpjYEAAAAAMAAE=",
    "weights": "zlib:eNr7z8DA8B+KARf0Av4=",
}
"""A skin of one triangle that follows a bone."""

SOLID = b"""$MeshFormat
2.2 0 8
$EndMeshFormat
$Nodes
4
1 0 0 0
2 1 0 0
3 0 1 0
4 0 0 1
$EndNodes
$Elements
2
1 2 2 0 1 1 2 3
2 4 2 0 1 1 2 3 4
$EndElements
"""

NEW_SOLID = b"""$MeshFormat
4.1 0 8
$EndMeshFormat
$Nodes
1 4 1 4
3 1 0 4
1
2
3
4
0 0 0
1 0 0
0 1 0
0 0 1
$EndNodes
$Elements
1 1 1 1
3 1 4 1
1 1 2 3 4
$EndElements
"""

WALK = b"time [s],x [m],y [m],z [m],heading [rad]\n0,0,0,1,0\n0.5,1,0,1,0.2\n1,2,0,1,0.4\n"
TURN = b"time,x,y,z,qw,qx,qy,qz\n0,0,0,1,1,0,0,0\n1,2,0,1,0.8,0,0,0.6\n"


def seeds() -> dict[str, dict[str, bytes]]:
    """Return per parser its seeds by name."""
    table = np.array([[0.0, 0.1], [0.02, 0.2], [0.04, 0.3]])
    arrays = {"time": table[:, 0], "states": table[:, 1:], "controls": table[:, 1:]}
    names = {"state_names": np.array(["angle rad"]), "control_names": np.array(["torque N*m"])}
    plain, packed = io.BytesIO(), io.BytesIO()
    np.savez(plain, **arrays, **names, run=np.zeros(3, int))
    np.savez_compressed(packed, **arrays, **names)
    _, metadata = read_tensors(shipped_path("pendulum"), "emulator")
    parts = {
        key: metadata[key]
        for key in ("bounds", "features", "network", "frame", "rest", "rates", "state", "dt")
    }
    skinned = {"skeleton": {"bones": metadata["skeleton"], "skin": SKIN}}
    shard = {
        "tensors": {
            "states": ["F32", [2, 41, 6], 0],
            "controls": ["F32", [2, 40, 3], 0],
            "samples": ["I32", [2, 12], 1],
        },
        "metadata": {"diverged": 0},
    }
    who = write_character(Path(__file__).parent / "who.glb")
    character = read_glb(who).document
    who.unlink()
    small = Path(__file__).parent / "small.safetensors"
    write_tensors(
        small,
        {"w": np.ones((2, 1), np.float32), "n": np.arange(2, dtype=np.int32)},
        {"kind": "emulator"},
    )
    sealed = small.read_bytes()
    small.unlink()
    text = json.dumps({"definition": {"name": "a", "model": "m.xml", "physics": {"step": 0.01, "truth_step": 0.01,
        "fine_step": 0.001}}, "files": {"main": "m.xml", "files": {"m.xml": "PGEvPg=="}}})  # fmt: skip
    setting = json.dumps(
        {
            "format": 2,
            "system": "pendulum",
            "substeps": 50,
            "count": 24,
            "samples_per_run": 12,
            "seed": 0,
        }
    )
    return {
        "clip": {"good": b"time s,angle[0] rad,angle[1] rad,speed[0] rad/s\n0,1,2,3\n0.1,1,2,3\n"},
        "config": {"good": setting.encode()},
        "csv": {"good": RECORDING.encode()},
        "dataset": {"good": json.dumps(shard).encode()},
        "definition": {"model": text.encode()},
        "emulator": {
            **{key: json.dumps({key: value}).encode() for key, value in parts.items()},
            "skin": json.dumps(skinned).encode(),
        },
        "glb": {"good": json.dumps(CHARACTER).encode()},
        "mesh": {"good": b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1/1 2/2 3/3 4/4\nf -4 -3 -2\n"},
        "model": {"mjcf": MODEL.encode(), "urdf": ROBOT.encode()},
        "npz": {"plain": plain.getvalue(), "packed": packed.getvalue()},
        "numbers": {"good": b"96,64"},
        "objective": {"good": OBJECTIVE.encode()},
        "path": {"walk": WALK, "turn": TURN},
        "request": {key: json.dumps(value).encode() for key, value in REQUESTS.items()},
        "rig": {"good": json.dumps(character).encode()},
        "solid": {"old": SOLID, "new": NEW_SOLID},
        "state": {"good": b"[[0.1, 2, -3e4], [1, 2, 3]]"},
        "tensors": {"good": sealed},
        "toml": {"jelly": JELLY.encode(), "recorded": STEP.encode(), "function": FUNCTION.encode(),
                 "lander": (ASSETS / "lander.toml").read_bytes()},
    }  # fmt: skip


def write_seeds() -> None:
    """Put the seeds into the corpus; what is there stays."""
    for parser, files in seeds().items():
        inputs = read_corpus(parser)
        for name, content in files.items():
            inputs[f"seed-{name}"] = content
        write_corpus(parser, inputs)


if __name__ == "__main__":
    write_seeds()
