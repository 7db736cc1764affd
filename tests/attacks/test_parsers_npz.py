"""Recordings and clips of strangers, packed or as text: refused by name, within a second and 100 MB."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest
from fuzz.measure import Refusal, check_refusal, refusals

from neuroanimator.errors import BadFileError
from neuroanimator.export.csv_file import read_table
from neuroanimator.physics.recorded.npz_file import read_npz
from neuroanimator.state.layout import Layout, Slice

TIMES = np.arange(3) * 0.02
GOOD = {
    "time": TIMES,
    "states": TIMES[:, None],
    "controls": TIMES[:, None],
    "state_names": np.array(["angle rad"]),
    "control_names": np.array(["torque N*m"]),
}


def npy(header: str, payload: bytes = b"", version: tuple[int, int] = (1, 0)) -> bytes:
    length = struct.pack("<H" if version == (1, 0) else "<I", len(header))
    return b"\x93NUMPY" + bytes(version) + length + header.encode("latin-1") + payload


def described(descr: str = "'<f8'", shape: str = "(3,)", order: str = "False") -> str:
    return f"{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}\n"


def archive(members: dict[str, bytes], method: int = zipfile.ZIP_STORED) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", method) as file:
        for name, content in members.items():
            file.writestr(name, content)
    return packed.getvalue()


def saved(compressed: bool = False, **changes: object) -> bytes:
    packed = io.BytesIO()
    arrays = {key: np.asarray(value) for key, value in (GOOD | changes).items()}
    (np.savez_compressed if compressed else np.savez)(packed, **arrays)  # pyright: ignore[reportArgumentType]
    return packed.getvalue()


def with_time(content: bytes) -> bytes:
    return archive({"time.npy": content})


def flipped(content: bytes, mark: bytes, offset: int, value: int) -> bytes:
    position = content.index(mark) + offset
    return content[:position] + bytes([value]) + content[position + 1 :]


PACKED = saved(compressed=True)
DEFLATED = archive({"time.npy": npy(described(), bytes(24))}, zipfile.ZIP_DEFLATED)
CLAIM = described(shape="(4000000000,)")
NPZ = {
    "no archive": (b"PK\x03\x04 and nothing more", "not a usable NPZ"),
    "cut short": (PACKED[: len(PACKED) // 2], "not a usable NPZ"),
    "a claimed shape of 4e9": (with_time(npy(CLAIM)), "not a usable NPZ"),
    "a claimed shape beyond 64 bits": (
        with_time(npy(described(shape=f"({2**40}, {2**40})"))),
        "not a usable NPZ",
    ),
    "a negative shape": (with_time(npy(described(shape="(-3,)"))), "not a usable NPZ"),
    "forty axes": (with_time(npy(described(shape="(" + "1," * 40 + ")"), bytes(8))), "40 axes"),
    "too few bytes": (with_time(npy(described(), bytes(16))), "not a usable NPZ"),
    "a pickle": (
        with_time(npy(described("'|O'"), b"cos\nsystem\n(S'true'\ntR.")),
        "not a usable NPZ",
    ),
    "a named column of pickles": (
        with_time(npy(described("[('a', '|O')]"), bytes(24))),
        "not a usable NPZ",
    ),
    "a header that is no dictionary": (with_time(npy("[" * 1000)), "not a usable NPZ"),
    "a header of minus signs": (with_time(npy("-" * 2000 + "1")), "not a usable NPZ"),
    "a header without end": (
        with_time(npy("{'descr': '<f8', 'fortran_order': (")),
        "not a usable NPZ",
    ),
    "a header of a megabyte": (with_time(npy(" " * 2**20, version=(2, 0))), "not a usable NPZ"),
    "an unknown type": (with_time(npy(described("'<q9'"), bytes(24))), "not a usable NPZ"),
    "a type that is a list": (with_time(npy(described("[]"), bytes(24))), "not a usable NPZ"),
    "an unknown version": (
        with_time(npy(described(), bytes(24), version=(9, 0))),
        "not a usable NPZ",
    ),
    "no array": (with_time(b"hello"), "not a usable NPZ"),
    "a zip bomb": (
        archive({"time.npy": bytes(64 * 2**20)}, zipfile.ZIP_DEFLATED),
        "bytes unpacked",
    ),
    "a zip bomb of another name": (
        archive({"a.npy": bytes(64 * 2**20)}, zipfile.ZIP_DEFLATED),
        "no array 'time'",
    ),
    "very many members": (archive({f"{i}.npy": b"" for i in range(5_000)}), "5,000 files"),
    "an unknown packing": (
        flipped(archive({"time.npy": b"1"}), b"PK\x01\x02", 10, 99),
        "not a usable NPZ",
    ),
    "a password": (
        flipped(flipped(saved(), b"PK\x01\x02", 8, 1), b"PK\x03\x04", 6, 1),
        "not a usable NPZ",
    ),
    "a damaged stream": (flipped(DEFLATED, b"time.npy", 8, 0xFF), "not a usable NPZ"),
    "characters that are none": (
        saved(state_names=np.array([0x7FFFFFFF], "<u4").view("<U1")),
        "holds no texts",
    ),
    "truth values for time": (saved(time=[True, False, True]), "holds bool"),
    "complex states": (saved(states=TIMES[:, None] + 1j), "wanted numbers"),
    "infinite states": (saved(states=np.full((3, 1), np.inf)), "not a finite number"),
    "states beyond single precision": (saved(states=np.full((3, 1), 1e300)), "not a finite number"),
    "one number for all": (saved(states=1.0), "states has shape ()"),
    "no rows": (saved(time=[], states=np.zeros((0, 1)), controls=np.zeros((0, 1))), "0 rows"),
    "a time that stands still": (saved(time=np.zeros(3)), "after the row before"),
    "a time in almost nothing": (saved(time=TIMES * 1e-300), "Give the time in seconds"),
    "very many columns": (
        saved(state_names=np.array(["a rad"] * 1000)),
        "lists 1000 names for 1 columns",
    ),
}

HEAD = "run,time s,state.angle rad,control.torque N·m\n"
CSV = {
    "a cell over 131,072 characters": (
        HEAD + "0,0," + "1" * 140_000 + ",1\n",
        "characters in a line",
    ),
    "a quoted cell over 131,072 characters": (
        HEAD + '0,0,"' + "1" * 140_000 + '",1\n',
        "characters in a line",
    ),
    "one line of 20 MB": ("a" * 20_000_000, "characters in a line"),
    "very many columns": ("time s," + "state.a rad," * 5_000, "columns"),
    "a quote without end": (HEAD + '0,0,"1,1\n', "cells; wanted 4"),
    "no characters": (HEAD + "0,0,\x00,1\n", "wanted a finite number"),
    "half a character": (HEAD.encode() + b"0,0,\xff,1\n", "not text in UTF-8"),
    "a number of 5,000 digits": (HEAD + "0,0," + "1" * 5_000 + ",1\n", "wanted a finite number"),
    "a number beyond single precision": (HEAD + "0,0,1e300,1\n", "wanted a finite number"),
    "100,000 runs of one row": (
        HEAD + "".join(f"{i},0,1,1\n" for i in range(100_000)),
        "one row only",
    ),
    "100,000 short rows": (HEAD + "1\n" * 100_000, "line 2: 1 cells"),
    "nothing but line breaks": ("\n" * 1_000_000, "no column 'time s'"),
    "old line breaks": (HEAD.replace("\n", "\r") + "0,0,1,1\r0,1,1\r", "line 3: 3 cells"),
}

CLIP = "time s,angle[0] rad,angle[1] rad,speed[0] rad/s\n"
CLIPS = {
    "a cell over 131,072 characters": (CLIP + "0,1,2," + "1" * 140_000, "characters in a line"),
    "no number": (CLIP + "0,1,2,x\n", "line 2"),
    "an infinite number": (CLIP + "0,1,2,1e999\n", "wanted a finite number"),
    "too few": (CLIP + "0,1,2\n", "line 2: 3 cells; wanted 4"),
    "no rows": (CLIP, "no rows"),
    "nothing": ("", "wanted the header"),
    "no text": (CLIP.encode() + b"\xff", "not text in UTF-8"),
}

XML = {
    "half a million elements": (
        "<mujoco>" + "<a/>" * 500_000 + "</mujoco>",
        "more than 10,000 elements",
    ),
    "a step of almost nothing": (
        '<mujoco><option timestep="1e-300"/><worldbody><body><joint/><geom size="1"/></body></worldbody></mujoco>',
        "option timestep",
    ),
    "a size of 5,000 digits": (
        f'<mujoco><size nkey="{"1" * 5_000}"/></mujoco>',
        "number is too large",
    ),
    "a name of a megabyte": (
        f'<mujoco><plugin name="{"a" * 2**20}"/></mujoco>',
        "plugins run foreign code",
    ),
    "deep elements": ("<a>" * 100_000, "elements deep"),
    "many attributes": (
        "<mujoco " + " ".join(f'a{i}=""' for i in range(150_000)) + "/>",
        "100 attributes",
    ),
    "a million numbers": (
        '<mujoco><worldbody><body><joint/><geom size="'
        + "1 " * 1_000_000
        + '"/></body></worldbody></mujoco>',
        "",
    ),
    "a million characters": (
        '<mujoco><worldbody><body><joint/><geom rgba="'
        + "a" * 1_000_000
        + '"/></body></worldbody></mujoco>',
        "",
    ),
    "an entity": ('<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', "document types"),
    "an unknown encoding": ('<?xml version="1.0" encoding="klingon"?><a/>', "not XML"),
    "no text": (b"\xff\xfe\x00", "not XML"),
}

BORDERS: dict[str, dict[str, tuple[str | bytes, str]]] = {
    "npz": {name: (content, message) for name, (content, message) in NPZ.items()},
    "csv": {name: (content, message) for name, (content, message) in CSV.items()},
    "clip": {name: (content, message) for name, (content, message) in CLIPS.items()},
    "model": {name: (content, message) for name, (content, message) in XML.items()},
}
ATTACKS = [(border, name) for border, attacks in BORDERS.items() for name in attacks]


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Refusal]:
    inputs = {}
    for border, name in ATTACKS:
        content = BORDERS[border][name][0]
        inputs[f"{border}: {name}"] = (
            border,
            content.encode() if isinstance(content, str) else content,
        )
    return refusals(inputs, tmp_path_factory.mktemp("inputs"))


@pytest.mark.parametrize(("border", "name"), ATTACKS)
def test_it_is_refused_in_a_second_and_100_megabytes(
    answers: dict[str, Refusal], border: str, name: str
):
    check_refusal(answers[f"{border}: {name}"], BORDERS[border][name][1])


def test_every_flipped_byte_of_an_npz_is_refused_or_read():
    content = saved(compressed=True)
    refusals_told = []
    for position in range(len(content)):
        damaged = bytearray(content)
        damaged[position] ^= 0xFF
        try:
            read_npz(bytes(damaged), "a.npz")
        except BadFileError as error:
            refusals_told.append(str(error))
    assert len(refusals_told) > len(content) / 2
    assert not [message for message in refusals_told if "\n" in message]


def test_plain_and_packed_arrays_of_any_number_type_and_order_are_read():
    for compressed in (False, True):
        for dtype in ("<f8", ">f4", "i2", "u1"):
            states = np.asfortranarray(np.arange(6).reshape(3, 2).astype(dtype))
            names = np.array(["angle rad", "speed rad/s"])
            found = read_npz(saved(compressed, states=states, state_names=names), "a.npz")
            np.testing.assert_array_equal(found.states, np.arange(6).reshape(3, 2))


def test_well_packed_recordings_of_a_size_users_have_are_read():
    time = np.arange(100_000) * 0.02
    still = np.zeros((len(time), 4))
    names = np.array([f"a{i} rad" for i in range(4)])
    content = saved(True, time=time, states=still, controls=time[:, None], state_names=names)
    assert len(content) < 0.2 * 8 * len(time) * 6
    assert read_npz(content, "a.npz").states.shape == (len(time), 4)


def test_a_damaged_stream_is_one_zlib_itself_refuses():
    with pytest.raises(zlib.error), np.load(io.BytesIO(NPZ["a damaged stream"][0])) as file:
        _ = file["time"]


def test_a_table_is_read_as_it_was_written(tmp_path: Path):
    path = tmp_path / "a.csv"
    path.write_text("time s,x[0] m\n0,1.5\n0.1,-2\n")
    times, rows = read_table(path, Layout((Slice("x", 1, "m"),)))
    np.testing.assert_array_equal(times, [0, 0.1])
    np.testing.assert_array_equal(rows, [[1.5], [-2.0]])
