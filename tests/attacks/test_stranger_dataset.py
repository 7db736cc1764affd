"""A stranger's dataset: its hashes match, for they prove nothing, and what it holds is none."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neuroanimator import (
    DatasetConfig,
    NeuroAnimatorError,
    generate,
    read_diverged,
    read_transitions,
)
from neuroanimator.errors import BadFileError
from neuroanimator.files.atomic import read_tensors, write_tensors
from neuroanimator.learn.data.store import CONFIG_NAME

Tensors = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("stranger") / "pendulum"
    generate(DatasetConfig(system="pendulum", count=96), folder)
    return folder


@pytest.fixture
def folder(honest: Path, tmp_path: Path) -> Path:
    shutil.copytree(honest, tmp_path / "data")
    return tmp_path / "data"


def forge(folder: Path, change: Callable[[Tensors, dict[str, Any]], object]) -> None:
    """Change the first shard's tensors or metadata and seal it again."""
    path = folder / "shard-00000.safetensors"
    found, metadata = read_tensors(path, "shard")
    tensors = {name: array.copy() for name, array in found.items()}
    change(tensors, metadata)
    write_tensors(path, tensors, metadata)


def set_sample(value: int) -> Callable[[Tensors, dict[str, Any]], None]:
    def change(tensors: Tensors, _: dict[str, Any]) -> None:
        tensors["samples"][0, 0] = value

    return change


def replace(
    name: str, made: Callable[[np.ndarray], np.ndarray]
) -> Callable[[Tensors, dict[str, Any]], None]:
    def change(tensors: Tensors, _: dict[str, Any]) -> None:
        tensors[name] = np.asarray(made(tensors[name]))

    return change


SHARDS: dict[str, tuple[Callable[[Tensors, dict[str, Any]], object], str]] = {
    "no states": (lambda tensors, _: tensors.pop("states"), "tensors controls, samples; wanted"),
    "no controls": (lambda tensors, _: tensors.pop("controls"), "tensors samples, states; wanted"),
    "no samples": (lambda tensors, _: tensors.pop("samples"), "tensors controls, states; wanted"),
    "nothing": (lambda tensors, _: tensors.clear(), "tensors none; wanted"),
    "one more": (
        lambda tensors, _: tensors.update(segments=tensors["samples"][:, 0]),
        "segments, states; wanted",
    ),
    "a negative sample": (set_sample(-1), "'samples' holds -1 to"),
    "a sample beyond the run": (set_sample(37), "wanted 0 to 36"),
    "a sample far beyond the run": (set_sample(2**31 - 1), "wanted 0 to 36"),
    "samples with fractions": (
        replace("samples", lambda samples: samples.astype(np.float32)),
        "'samples' holds float32",
    ),
    "states as whole numbers": (
        replace("states", lambda states: states.astype(np.int32)),
        "'states' holds int32",
    ),
    "states in double precision": (
        replace("states", lambda states: states.astype(float)),
        "'states' holds float64",
    ),
    "fewer numbers in a state": (
        replace("states", lambda states: states[..., :-1]),
        "wanted (8, 41, 6)",
    ),
    "another number of controls": (
        replace("controls", lambda controls: controls[..., :1]),
        "wanted (8, 40, 3)",
    ),
    "shorter runs": (replace("states", lambda states: states[:, :-5]), "wanted (8, 41, 6)"),
    "a run less": (replace("states", lambda states: states[:-1]), "wanted (7, 40, 3)"),
    "flat states": (replace("states", np.ravel), "tensor 'states' has shape (1968,)"),
    "one number for all": (
        replace("states", lambda states: states[0, 0, 0]),
        "tensor 'states' has shape ()",
    ),
    "flat samples": (
        replace("samples", lambda samples: samples[:, 0]),
        "tensor 'samples' has shape (8,)",
    ),
    "no diverged runs told": (
        lambda _, metadata: metadata.pop("diverged"),
        "diverged: wanted a whole number from 0 to 8, got 'None'",
    ),
    "diverged runs in words": (
        lambda _, metadata: metadata.update(diverged="many"),
        "diverged: wanted a whole number from 0 to 8, got 'many'",
    ),
    "negative diverged runs": (
        lambda _, metadata: metadata.update(diverged=-1),
        "diverged: wanted a whole number from 0 to 8, got '-1'",
    ),
    "diverged runs that are no number": (
        lambda _, metadata: metadata.update(diverged=True),
        "diverged: wanted a whole number from 0 to 8, got 'True'",
    ),
    "too many diverged runs": (
        lambda _, metadata: metadata.update(diverged=3),
        "8 rows and 3 diverged; wanted 8",
    ),
    "another shard": (lambda _, metadata: metadata.update(shard=1), "belongs to another dataset"),
    "infinite states": (
        replace("states", lambda states: states + np.float32(np.inf)),
        "NaN or infinite",
    ),
}


@pytest.mark.parametrize("name", SHARDS)
def test_a_shard_that_is_none_is_refused_by_name(folder: Path, name: str):
    change, message = SHARDS[name]
    forge(folder, change)
    with pytest.raises(BadFileError) as caught:
        read_transitions(folder)
    assert message in str(caught.value)
    assert "shard-00000.safetensors" in str(caught.value)
    assert "\n" not in str(caught.value)


CONFIGS = {
    "a key twice": ('{"system": "pendulum", "system": "fish"}', "'system' occurs twice"),
    "no object": ("[]", "wanted a JSON object"),
    "deep": ('{"system":' * 100_000, "recursion limit"),
    "a long number": ('{"seed":' + "1" * 5_000 + "}", "number out of range"),
    "an unknown key": ('{"format": 2, "system": "pendulum", "more": 1}', "more: extra inputs"),
    "a negative count": ('{"format": 2, "system": "pendulum", "count": -1}', "count: "),
    "no text": ("\xff", "is damaged"),
}


@pytest.mark.parametrize("name", CONFIGS)
def test_settings_that_are_none_are_refused(folder: Path, name: str):
    text, message = CONFIGS[name]
    (folder / CONFIG_NAME).write_bytes(text.encode("latin-1"))
    with pytest.raises(BadFileError, match="dataset.json is damaged") as caught:
        read_transitions(folder)
    assert message in str(caught.value)
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize("format_number", [None, 1, 3, 2.0, True, "2"])
def test_a_dataset_of_another_version_is_refused_in_one_line(folder: Path, format_number: object):
    config = json.loads((folder / CONFIG_NAME).read_text()) | {"format": format_number}
    (folder / CONFIG_NAME).write_text(json.dumps(config))
    with pytest.raises(BadFileError, match="is of another version") as caught:
        read_transitions(folder)
    assert str(caught.value).endswith("this one reads 2. Generate the dataset again.")
    assert "\n" not in str(caught.value)


def test_more_in_the_folder_than_its_settings_say_is_refused(folder: Path):
    config = json.loads((folder / CONFIG_NAME).read_text()) | {"count": 12}
    (folder / CONFIG_NAME).write_text(json.dumps(config))
    with pytest.raises(NeuroAnimatorError, match="shard-00000"):
        read_transitions(folder)


def test_a_shard_as_large_as_a_disk_is_refused_unread(folder: Path):
    with open(folder / "shard-00000.safetensors", "r+b") as file:
        file.truncate(2**40)
    with pytest.raises(BadFileError, match="1,099,511,627,776 bytes; wanted at most"):
        read_transitions(folder)


def test_a_damaged_shard_is_made_again_with_the_same_bytes(folder: Path, honest: Path):
    forge(folder, set_sample(-1))
    generate(DatasetConfig(system="pendulum", count=96), folder)
    name = "shard-00000.safetensors"
    assert (folder / name).read_bytes() == (honest / name).read_bytes()


@pytest.mark.parametrize(
    ("starts", "controls", "message"),
    [
        (np.zeros((1, 5)), np.zeros((1, 40, 3)), "tensor 'starts' has shape (1, 5); wanted (1, 6)"),
        (
            np.zeros((1, 6)),
            np.zeros((1, 40, 1)),
            "tensor 'controls' has shape (1, 40, 1); wanted (1, 40, 3)",
        ),
        (np.zeros((1, 6)), np.zeros((2, 40, 3)), "wanted (1, 40, 3)"),
        (np.zeros((1, 6), np.float32), np.zeros((1, 40, 3)), "'starts' holds float32"),
    ],
)
def test_runs_that_diverged_are_held_against_the_system(
    folder: Path, starts: np.ndarray, controls: np.ndarray, message: str
):
    config = DatasetConfig(system="pendulum", count=96)
    metadata = {"kind": "diverged", "config": config.hash, "shard": 0}
    write_tensors(
        folder / "diverged-00000.safetensors", {"starts": starts, "controls": controls}, metadata
    )
    with pytest.raises(BadFileError) as caught:
        read_diverged(folder)
    assert message in str(caught.value)
