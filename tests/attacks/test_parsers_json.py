"""JSON of strangers, in headers, definitions and datasets: refused within a second and 100 MB."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from fuzz.measure import Refusal, check_refusal, refusals

from neuroanimator.errors import BadFileError
from neuroanimator.files.atomic import METADATA_KEY, read_tensors, write_tensors
from neuroanimator.systems.model_files import ModelFiles

ANY = 2**20 - 100
"""[bytes] Almost as much as a header may take."""

TEXTS = {
    "a list": ("[]", "wanted a JSON object, got a list"),
    "a text": ('"a"', "wanted a JSON object, got a str"),
    "a number": ("1", "wanted a JSON object, got a int"),
    "nothing": ("null", "wanted a JSON object, got a NoneType"),
    "deep lists": ('{"a":' + "[" * 100_000, "recursion limit"),
    "deep objects": ('{"a":' * 100_000, "recursion limit"),
    "a long whole number": ('{"a":' + "1" * 5_000 + "}", "number out of range"),
    "a number beyond all": ('{"a":1e999}', "too large"),
    "no number": ('{"a":NaN}', "expected value"),
    "no end": ('{"a":-Infinity}', "invalid number"),
    "a name twice": ('{"a":1,"a":2}', "'a' occurs twice"),
    "half a character": ('{"a":"\\ud800"}', "hex escape"),
    "empty": ("", ""),
    "many lists": ('{"a":[' + "[]," * (ANY // 3) + "]}", ""),
    "many objects": ('{"a":[' + "{}," * (ANY // 3) + "]}", ""),
    "many names": ("{" + ",".join(f'"{i}":{i}' for i in range(60_000)) + "}", ""),
    "quotes without end": ('{"a":"' + '\\"' * (ANY // 2), ""),
}


def with_header(header: str, payload: bytes = b"") -> bytes:
    raw = header.encode()
    return len(raw).to_bytes(8, "little") + raw + payload


BORDERS = {
    "header": ("tensors", with_header),
    "metadata": (
        "tensors",
        lambda text: with_header(json.dumps({"__metadata__": {METADATA_KEY: text}})),
    ),
    "settings": ("config", str.encode),
    "definition": ("definition", str.encode),
}
"""Where JSON comes in: the parser, and the text as it reads it."""


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Refusal]:
    inputs = {}
    for border, (parser, wrapped) in BORDERS.items():
        for name, (text, _) in TEXTS.items():
            inputs[f"{border}: {name}"] = (parser, wrapped(text))
    return refusals(inputs, tmp_path_factory.mktemp("json"))


@pytest.mark.parametrize("border", BORDERS)
@pytest.mark.parametrize("name", TEXTS)
def test_json_is_refused_in_a_second_and_100_megabytes(
    answers: dict[str, Refusal], border: str, name: str
):
    message = "" if border == "definition" or len(TEXTS[name][0]) > ANY // 2 else TEXTS[name][1]
    check_refusal(answers[f"{border}: {name}"], message)


def entry(
    dtype: object = "F32", shape: object = (1,), offsets: object = (0, 4)
) -> dict[str, object]:
    return {"dtype": dtype, "shape": shape, "data_offsets": offsets}


ENTRIES = {
    "no object": {"a": 1},
    "no shape": {"a": {"dtype": "F32", "data_offsets": [0, 4]}},
    "another key": {"a": {**entry(), "more": 1}},
    "a type that is a list": {"a": entry(dtype=[])},
    "an unknown type": {"a": entry(dtype="BF16")},
    "a shape that is a number": {"a": entry(shape=1)},
    "a shape of texts": {"a": entry(shape=["1"])},
    "a shape of fractions": {"a": entry(shape=[1.0])},
    "a negative length": {"a": entry(shape=[-1])},
    "a claimed length of 4e9": {"a": entry(shape=[4_000_000_000])},
    "a product beyond 64 bits": {"a": entry(shape=[2**40, 2**40])},
    "too many axes": {"a": entry(shape=[1] * 64)},
    "offsets backwards": {"a": entry(offsets=[4, 0])},
    "one offset": {"a": entry(offsets=[0])},
    "offsets beyond the file": {"a": entry(offsets=[4, 8])},
    "an overlap": {"a": entry(), "b": entry()},
    "a gap": {"a": entry(), "b": entry(offsets=[8, 12])},
    "too many tensors": {f"a{i}": entry(offsets=[4 * i, 4 * i + 4]) for i in range(300)},
}


@pytest.mark.parametrize("name", ENTRIES)
def test_a_tensor_s_place_is_refused_by_name(tmp_path: Path, name: str):
    header = {"__metadata__": {METADATA_KEY: "{}"}, **ENTRIES[name]}
    path = tmp_path / "a.safetensors"
    path.write_bytes(with_header(json.dumps(header), bytes(8)))
    with pytest.raises(BadFileError, match="a.safetensors is not a usable emulator file: "):
        read_tensors(path, "emulator")


def test_tensors_are_read_as_they_were_written(tmp_path: Path):
    rng = np.random.default_rng(1)
    tensors = {
        "matrix": rng.normal(size=(3, 4)).astype(np.float32),
        "number": np.float64(2.5).reshape(()),
        "none": np.zeros((0, 3), np.float32),
        "whole": np.arange(5, dtype=np.int32),
    }
    write_tensors(tmp_path / "a.safetensors", tensors, {"kind": "emulator", "unit": "N·m"})
    found, metadata = read_tensors(tmp_path / "a.safetensors", "emulator")
    assert metadata["unit"] == "N·m"
    assert set(found) == set(tensors)
    for name, array in tensors.items():
        np.testing.assert_array_equal(found[name], array)
        assert found[name].dtype == array.dtype


@pytest.mark.parametrize("name", ["", "a\n\x1b[1m", "a" * 1000, "\u2028"])
def test_a_file_name_that_cannot_be_printed_is_refused(name: str):
    for files in ({"main": name, "files": {}}, {"main": "a.xml", "files": {name: ""}}):
        with pytest.raises(BadFileError, match="is no file name") as caught:
            ModelFiles.from_json(files)
        assert str(caught.value).isprintable()
