"""Every number of an artifact is checked before it is used, whatever its seal says; refusing is quick and small."""

from __future__ import annotations

import copy
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from forgery import forged_emulator, forged_policy
from waiting import PATIENCE

from neuroanimator import Emulator
from neuroanimator.control.policies.policy import Policy
from neuroanimator.emulator.artifact import FAULTS
from neuroanimator.emulator.description import FORMAT, blank
from neuroanimator.errors import BadFileError
from neuroanimator.files.atomic import read_tensors, write_tensors
from neuroanimator.files.zoo import find_emulator

HUGE, MANY = 1e300, 10**4000


def put(metadata: dict[str, Any], path: str, value: Any) -> None:
    """Set the entry of `metadata` at a path such as `skeleton.0.joints.0.entry`."""
    *above, last = [int(key) if key.isdigit() else key for key in path.split(".")]
    position: Any = metadata
    for key in above:
        position = position[key]
    position[last] = value


NUMBERS = [
    ("dt", 0.0), ("dt", -0.05), ("dt", HUGE), ("dt", 1e-300), ("dt", "0.05"), ("dt", None), ("dt", True),
    ("dt", [0.05]),
    ("substeps", 0), ("substeps", -1), ("substeps", 50.5), ("substeps", 1001), ("substeps", MANY), ("substeps", True),
    ("bounds.0.0", 31.0), ("bounds.1.0", HUGE), ("bounds.0", [-1.0]), ("bounds", []), ("bounds", {"low": 1}),
    ("bounds.0.0", None), ("bounds.1.2", "4"),
    ("rest.0", HUGE), ("rest", []), ("rest", [0.0] * 7), ("rest.0", None), ("rest.0", "0"), ("rest", {}),
    ("rates", [[0, 6]]), ("rates", [[-1, 0]]), ("rates", [[0]]), ("rates", [[0.5, 3]]), ("rates", 3),
    ("state", []), ("state.0.1", 0), ("state.0.1", -3), ("state.0.1", 10**12), ("state.0.1", 2.5), ("state.0", ["a"]),
    ("state", [["a", 1, "m"]] * 10_000), ("control.0.1", 4), ("control", []),
    ("gait", [0.0, [0, 0, 0], [0, 0, 0]]), ("gait", [1e-300, [0, 0, 0], [0, 0, 0]]), ("gait", [1.0, [0, 0], [0, 0, 0]]),
    ("gait", [1.0, [HUGE, 0, 0], [0, 0, 0]]), ("gait", [1.0, [0, 0, 0], [0, 0, "0"]]), ("gait", 3),
    ("gait", [1.0, [0, 0, 0], [0, 0, 0], 1.5]),
    ("features.rows", -1), ("features.rows", 10**9), ("features.plain", [6]), ("features.plain", [-1]),
    ("features.plain", [0.5]), ("features.is_odd", 1), ("features.even", [1, 0]), ("features", []),
    ("network.widths", [4097]), ("network.widths", [0]), ("network.widths", [-1]), ("network.widths", [96.0, 64]),
    ("network.widths", [1] * 33), ("network.widths", "96"), ("network.widths", [MANY]), ("network.kind", ["gated"]),
    ("network.parts", [{}]), ("network.parts", 3), ("network.even", [0]),
    ("frame.has_gravity", 1), ("frame.external_forces", [[1.0, 0.0, 0.0]]), ("frame.external_forces", [[HUGE] * 3] * 3),
    ("frame.probe_modes", [[[0.0]]] * 3), ("frame.probe_modes", 3),
    ("frame.probes", [[0, 0, 0, 1]]), ("frame.probes", [[0, 0, 0]]), ("frame.segments", [["plain", 7, -1, 0.0]]),
    ("frame.segments", [["plain", -1, -1, 0.0], ["plain", 7, -1, 0.0]]), ("frame.segments", [["plain", 6, -2, 0.0]]),
    ("frame.segments", [["plain", 6, -1, HUGE]]), ("frame.segments", [[["plain"], 6, -1, 0.0]]),
    ("frame.segments", [["points", 6, -1, 0.0]]), ("frame", None),
    ("skeleton.0.offset", [0.0, 0.0]), ("skeleton.0.offset", [0.0, 0.0, HUGE]), ("skeleton.0.orientation", [0.0] * 4),
    ("skeleton.0.orientation", [1.0, 1.0, 0.0, 0.0]), ("skeleton.0.parent", 0), ("skeleton.0.parent", -2),
    ("skeleton.0.parent", "x"), ("skeleton.0.joints.0.entry", -1), ("skeleton.0.joints.0.entry", 6),
    ("skeleton.0.joints.0.entry", 0.5), ("skeleton.0.joints.0.axis", [0.0] * 3), ("skeleton.0.joints.0.axis", [0, 1]),
    ("skeleton.0.joints.0.anchor", [HUGE] * 3), ("skeleton.0.joints.0.reference", HUGE),
    ("skeleton.0.joints.0.kind", ["hinge"]), ("skeleton.0.joints", {}), ("skeleton.0.shapes.0.size", [-1, 1, 1]),
    ("skeleton.0.shapes.0.size", []), ("skeleton.0.shapes.0.colour", [2.0, 0, 0, 1]),
    ("skeleton.0.shapes.0.colour", [0.0, 0, 0]), ("skeleton.0.shapes.0.kind", "teapot"), ("skeleton.0", 3),
    ("skeleton", 3), ("skeleton", []), ("modes", {}), ("modes", 3), ("definition", "x" * 600_000), ("definition", "{}"),
    ("definition", "[" * 100_000), ("definition", '{"definition": 1, "files": 1}'),
]  # fmt: skip


@pytest.mark.parametrize("path", sorted({path for path, _ in NUMBERS}))
def test_a_number_no_emulator_has_is_refused(path: str, tmp_path: Path):
    for key, value in NUMBERS:
        if key != path or (key, value) == ("skeleton", []):
            continue
        file = forged_emulator(
            tmp_path / "e.safetensors", lambda metadata, value=value: put(metadata, path, value)
        )
        with pytest.raises(BadFileError) as caught:
            Emulator.load(file)
        assert str(caught.value).isprintable()
        assert len(str(caught.value)) < 1000, value


MODES = [
    ("modes.cloud", [[], []]), ("modes.cloud.1.0", 0.0), ("modes.cloud.1.0", 1e9),
    ("modes.cloud.0.0", [0.0, 1e300, 0.0]),
    ("modes.counts", [1, 2, 3]), ("modes.counts.0", -1), ("modes.counts.0", 10**9), ("modes.muscles", 11),
    ("modes.time_constant", -1.0), ("modes.time_constant", HUGE), ("modes.mirror.0.0", 10**6), ("modes.mirror", [[0]]),
    ("skeleton.bones.0.binding.position", [[0, 2.0]]), ("skeleton.bones.0.binding.position", [[-1, 1.0]]),
    ("skeleton.skin.kind", "x"), ("skeleton.skin.back", [HUGE, 0, 0]), ("gait.0", -1.0),
]  # fmt: skip


def test_numbers_no_deformable_body_has_are_refused(tmp_path: Path):
    for path, value in MODES:

        def change(metadata, path=path, value=value):
            return put(metadata, path, value)

        with pytest.raises(BadFileError):
            Emulator.load(forged_emulator(tmp_path / "e.safetensors", change, "fish-50"))


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("normaliser.feature_scale", lambda array: array * 0),
        ("normaliser.change_scale", lambda array: -array),
        ("domain.low", lambda array: array + 1e9),
        ("network", lambda array: array.astype(np.int32)),
        ("network", lambda array: array.astype(np.float64) * 1e300),
    ],
)
def test_weights_that_would_make_every_prediction_nan_are_refused(
    name: str, change: Any, tmp_path: Path
):
    tensors, metadata = read_tensors(find_emulator("pendulum-50"), "emulator")
    chosen = next(key for key in sorted(tensors) if name in key)
    tensors[chosen] = change(tensors[chosen])
    del metadata["sha256"]
    write_tensors(tmp_path / "e.safetensors", tensors, metadata)
    with pytest.raises(BadFileError):
        Emulator.load(tmp_path / "e.safetensors")


@pytest.mark.parametrize(
    ("found", "advice"),
    [
        (
            FORMAT - 1,
            f"of an older version: format {FORMAT - 1}; this one reads {FORMAT}. Make it again",
        ),
        (
            FORMAT + 1,
            f"of a newer version: format '{FORMAT + 1}'; this one reads {FORMAT}. Upgrade NeuroAnimator",
        ),
        (None, "does not say its format"),
        ("3", "does not say its format"),
        (True, "does not say its format"),
    ],
)
def test_an_older_format_is_made_again_and_a_newer_one_asks_for_an_upgrade(
    found: Any, advice: str, tmp_path: Path
):
    path = forged_emulator(
        tmp_path / "e.safetensors", lambda metadata: metadata.update(format=found)
    )
    with pytest.raises(BadFileError, match=advice):
        Emulator.load(path)
    path = forged_policy(
        tmp_path / "p.safetensors", lambda metadata: metadata["emulator"].update(format=found)
    )
    with pytest.raises(BadFileError, match=advice):
        Policy.load(path)


def leaves(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the path of everything within a JSON value."""
    if path:
        yield path
    pairs = (
        value.items()
        if isinstance(value, dict)
        else enumerate(value)
        if isinstance(value, list)
        else ()
    )
    for key, latent in pairs:
        yield from leaves(latent, (*path, key))


STRANGE = [
    None,
    True,
    -1,
    0,
    2.5,
    10**30,
    1e300,
    "",
    "x",
    "\x1b",
    [],
    [[]],
    {},
    {"a": 1},
    [1e300] * 3,
]


@pytest.mark.parametrize("name", ["pendulum-50", "lander-50", "fish-50"])
def test_any_entry_replaced_by_anything_is_read_or_refused(name: str):
    """What `blank` may raise is what `load` catches; a real parser is fuzzed, not its words."""
    metadata = read_tensors(find_emulator(name), "emulator")[1]
    del metadata["provenance"]
    rng, positions = np.random.default_rng(0), list(leaves(metadata))
    refused = 0
    for _ in range(100):
        hostile, path = copy.deepcopy(metadata), positions[rng.integers(len(positions))]
        latent: Any = hostile
        for key in path[:-1]:
            latent = latent[key]
        latent[path[-1]] = STRANGE[rng.integers(len(STRANGE))]
        try:
            jax.eval_shape(lambda hostile=hostile: blank(hostile, Emulator))
        except FAULTS:
            refused += 1
    assert refused > 50


BOMBS = {
    "wide layers": {"network.widths": [4096] * 32},
    "many parts of a state": {"state": [[f"a{i}", 1, "m"] for i in range(4096)]},
    "deep definition": {"definition": "[" * 400_000},
    "many bones": {"skeleton": [{"name": "a"}] * 50_000},
    "many rates": {"rates": [[0, 0]] * 100_000},
    "many plain features": {"features.plain": [0] * 200_000},
    "many probes": {"frame.probes": [[0, 0, 0, 0]] * 60_000},
    "many segments": {"frame.segments": [["plain", 1, -1, 0.0]] * 40_000},
    "many parts of a hierarchy": {
        "network.kind": "hierarchy",
        "network.widths": [8, 0, 8],
        "network.parts": [
            {"name": "a", "odd": [*range(15)], "even": [], "answers": [0], "hears": [], "like": -1}
            for _ in range(200)
        ],
    },
}
"""Changes that ask for work: layers, parts and lists as many as a header has room for."""

WATCHER = """
import json, resource, sys, time
from pathlib import Path
from neuroanimator import Emulator, NeuroAnimatorError
paths = sys.argv[1:]
Emulator.load(paths[0])
rows = {}
for path in paths[1:]:
    before = resource.getrusage(resource.RUSAGE_SELF)
    try:
        Emulator.load(path)
        refused = False
    except NeuroAnimatorError:
        refused = True
    after = resource.getrusage(resource.RUSAGE_SELF)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    rows[Path(path).name] = [refused, seconds, (after.ru_maxrss - before.ru_maxrss) / 1024]
print(json.dumps(rows))
"""


def test_refusing_takes_less_than_a_second_and_a_hundred_megabytes(tmp_path: Path):
    files = [find_emulator("pendulum-50")]
    for number, changes in enumerate(BOMBS.values()):

        def change(metadata: dict[str, Any], changes: dict[str, Any] = changes) -> None:
            for path, value in changes.items():
                put(metadata, path, value)

        files.append(forged_emulator(tmp_path / f"{number}.safetensors", change))
    command = [sys.executable, "-c", WATCHER, *map(str, files)]
    found = json.loads(
        subprocess.run(command, capture_output=True, check=True, timeout=PATIENCE).stdout
    )
    for title, (refused, seconds, megabytes) in zip(BOMBS, found.values(), strict=True):
        assert refused, title
        assert seconds < 1, title
        assert megabytes < 100, title
