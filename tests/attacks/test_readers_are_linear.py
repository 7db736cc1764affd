"""Every reader of strangers' files takes time and memory in proportion to the file, whatever the file says of itself."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fuzz.measure import check_refusal, refusals
from fuzz.targets import TARGETS

from neuroanimator.export.gltf.buffers import glb_bytes

GROWTH = 4
"""Factor by which the second file is longer."""

MAX_RATIO = 2.5 * GROWTH
"""Maximum ratio of times and of memories: what is quadratic takes sixteen times as much."""

FREE_SECONDS = 0.3
"""Processor time within which no ratio is asked for [s]."""

FREE_MEGABYTES = 40.0
"""Memory within which no ratio is asked for."""

BYTES_A_BYTE = 200
"""Maximum memory for each byte of a file, beside `FREE_MEGABYTES`: a Python object for every two characters."""


def names(count: int, last: str = "") -> str:
    """Return a JSON object of so many different names, and one more."""
    return "{" + ",".join(f'"n{number}":0' for number in range(count)) + last + "}"


def table(count: int, columns: str = "time,a [rad]") -> bytes:
    rows = "\n".join(f"{number / 100:.2f},{number % 7}" for number in range(count))
    return f"{columns}\n{rows}\n".encode()


def keyframes(count: int, end: float = 1.0) -> dict:
    """Return a character's document with so many accessors, samplers and channels: of one node, the first ones its own."""
    accessors = [
        {"type": kind, "componentType": 5126, "count": 2, "bufferView": 0}
        for kind in ("SCALAR", "VEC3")
    ]
    accessors += [accessors[0]] * count
    samplers = [{"input": 0, "output": 1}] + [
        {"input": 2 + number, "output": 1} for number in range(count)
    ]
    channels = [{"sampler": 0, "target": {"node": 0, "path": "translation"}}]
    channels += [
        {"sampler": 1 + number, "target": {"node": 1, "path": "translation"}}
        for number in range(count)
    ]
    return {
        "buffers": [{"byteLength": 32}],
        "bufferViews": [{"buffer": 0, "byteLength": 32}],
        "accessors": accessors,
        "nodes": [{"name": "hips"}, {"name": "hand"}],
        "animations": [{"samplers": samplers, "channels": channels}],
    }


def many_meshes(count: int) -> dict:
    """Return a character of animated nodes, each with the same mesh of points that are not there."""
    nodes = [{"name": f"n{number}", "mesh": 0} for number in range(count)]
    channels = [{"target": {"node": number}} for number in range(count)]
    meshes = [{"primitives": [{"attributes": {"POSITION": 0}}]}]
    return {"nodes": nodes, "meshes": meshes, "animations": [{"channels": channels}]}


def many_joints(count: int) -> dict:
    """Return a character with a skin of all of its nodes, in a row of a thousand and the others below its end."""
    chain = [{"name": f"n{number}", "children": [number + 1]} for number in range(900)]
    below = [{"name": f"m{number}"} for number in range(count)]
    chain[-1]["children"] = list(range(900, 900 + count))
    skins = [{"joints": list(range(900 + count))}]
    return {"nodes": [*chain, *below], "skins": skins}


def many_nodes(count: int) -> dict:
    document = keyframes(1)
    document["nodes"] += [{"name": f"n{number}"} for number in range(count)]
    document["nodes"][1]["children"] = list(range(2, 2 + count))
    return document


def arrays(count: int) -> bytes:
    file = io.BytesIO()
    np.savez(file, **{f"n{number}": np.zeros(3) for number in range(count)})
    return file.getvalue()


def header(count: int) -> bytes:
    entry = {"dtype": "F32", "shape": [0], "data_offsets": [0, 0]}
    text = json.dumps({f"n{number}": entry for number in range(count)}).encode()
    return len(text).to_bytes(8, "little") + text


def bodies(count: int) -> bytes:
    body = '<body><joint name="j{0}"/><geom size="1"/></body>'
    inside = "".join(body.format(number) for number in range(count))
    return f"<mujoco><worldbody>{inside}</worldbody></mujoco>".encode()


def links(count: int) -> bytes:
    parts = ['<robot name="r"><link name="l0"/>']
    for number in range(1, count):
        parts.append(
            f'<link name="l{number}"/><joint name="j{number}" type="fixed">'
            f'<parent link="l0"/><child link="l{number}"/></joint>'
        )
    return ("".join(parts) + "</robot>").encode()


def surface(count: int, gap: str = " ") -> bytes:
    """Return a strip of triangles."""
    vertices = "".join(f"v{gap}{number // 2}{gap}{number % 2}{gap}0\n" for number in range(count))
    faces = "".join(f"f {number} {number + 1} {number + 2}\n" for number in range(1, count - 1))
    return (vertices + faces).encode()


def volume(count: int, before: str = "") -> bytes:
    """Return a heap of tetrahedra that share their first three nodes."""
    nodes = "".join(f"{number} {number} {number % 3} {number % 5}\n" for number in range(1, count))
    elements = "".join(f"{number} 4 0 1 2 3 {number}\n" for number in range(4, count))
    return (
        f"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n{before}$Nodes\n{count - 1}\n{nodes}$EndNodes\n"
        f"$Elements\n{count - 4}\n{elements}$EndElements\n"
    ).encode()


def as_json(document: object) -> bytes:
    return json.dumps(document).encode()


FILES: dict[str, tuple[str, Callable[[int], bytes], int]] = {
    "names": ("config", lambda count: names(count).encode(), 5_000),
    "a name twice, last": (
        "config",
        lambda count: names(count, f',"n{count - 1}":0').encode(),
        25_000,
    ),
    "settings of an emulator": ("emulator", lambda count: names(count).encode(), 2_000),
    "a definition's names": ("definition", lambda count: names(count).encode(), 5_000),
    "tensors of a header": ("tensors", header, 2_500),
    "keys of a definition": (
        "toml",
        lambda count: "".join(f"n{number} = 0\n" for number in range(count)).encode(),
        2_000,
    ),
    "tables of an objective": (
        "objective",
        lambda count: ('[[terms]]\nkind = "effort"\n' * count).encode(),
        500,
    ),
    "rows of a recording": ("csv", table, 10_000),
    "columns of a recording": (
        "csv",
        lambda count: (",".join(["time"] + [f"a{n} [rad]" for n in range(count)]) + "\n").encode(),
        500,
    ),
    "one line of a recording": ("csv", lambda count: b"0" * count, 500_000),
    "arrays of a recording": ("npz", arrays, 500),
    "rows of a clip": ("clip", lambda count: table(count, "time,angle[0] [rad]"), 10_000),
    "rows of a path": ("path", lambda count: table(count, "time,x [m]"), 10_000),
    "samplers of a character": ("glb", lambda count: as_json(keyframes(count)), 5_000),
    "nodes of a character": ("glb", lambda count: as_json(many_nodes(count)), 5_000),
    "meshes of a character": ("rig", lambda count: as_json(many_meshes(count)), 5_000),
    "joints of a character": ("rig", lambda count: as_json(many_joints(count)), 5_000),
    "bodies of a model": ("model", bodies, 250),
    "links of a robot": ("model", links, 250),
    "vertices of a surface": ("mesh", surface, 5_000),
    "vertices behind tabs": ("mesh", lambda count: surface(count, "\t"), 5_000),
    "one line of a surface": ("mesh", lambda count: b"v " + b"0 " * count, 500_000),
    "nodes of a solid": ("solid", volume, 2_500),
    "numbers of a state": ("state", lambda count: as_json([0.0] * count), 50_000),
    "numbers of a request": ("request", lambda count: as_json({"id": 1, "a": [0] * count}), 50_000),
    "widths": ("numbers", lambda count: b"8," * count, 50_000),
}
"""The parser (see fuzz/targets.py), and a file of a size."""


@pytest.mark.parametrize("name", FILES)
def test_four_times_the_file_takes_four_times_as_much(name: str, tmp_path: Path):
    parser, make, count = FILES[name]
    contents = {"short": make(count), "long": make(GROWTH * count)}
    answers = refusals({key: (parser, content) for key, content in contents.items()}, tmp_path)
    short, long = answers["short"], answers["long"]
    for key, answer in answers.items():
        assert not answer.error or answer.is_ours, answer
        own = FREE_MEGABYTES + BYTES_A_BYTE * len(contents[key]) / 2**20
        assert answer.megabytes < own, answer
    assert long.seconds < max(FREE_SECONDS, MAX_RATIO * short.seconds), (short, long)
    assert long.megabytes < max(FREE_MEGABYTES, MAX_RATIO * short.megabytes), (short, long)


@pytest.mark.parametrize("days", [1.0, 10.0])
def test_two_keyframes_days_apart_are_refused_before_anything_is_sampled(
    days: float, tmp_path: Path
):
    times = np.array([0.0, 86_400.0 * days], "<f4")
    binary = times.tobytes() + np.zeros(6, "<f4").tobytes()
    document = keyframes(0)
    document["bufferViews"].append({"buffer": 0, "byteOffset": 8, "byteLength": 24})
    document["accessors"][1]["bufferView"] = 1
    content = glb_bytes(document, binary)
    answer = refusals({"days": ("glb", content)}, tmp_path)["days"]
    check_refusal(answer, "Cut it into parts")


def test_every_parser_is_tried():
    # What they read is arrays that were sealed before: their bytes are those of a header.
    assert {parser for parser, _, _ in FILES.values()} | {"dataset"} == set(TARGETS)
