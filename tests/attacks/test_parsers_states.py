"""What Python callers give as states, controls and times: real numbers, or an ArgumentError."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from neuroanimator import Emulator, load_system, reach_position
from neuroanimator.cli.usage import whole_numbers
from neuroanimator.errors import ArgumentError
from neuroanimator.state.layout import Layout, Slice
from neuroanimator.systems.system import Scheme

LAYOUT = Layout((Slice("angle", 2, "rad"), Slice("speed", 1, "rad/s")))

NO_NUMBERS = {
    "a text": "hello",
    "a text of numbers": "1 2 3",
    "texts": ["1", "2", "3"],
    "bytes": b"123",
    "rows of unequal length": [[1.0, 2.0, 3.0], [1.0]],
    "numbers beside rows": [1.0, [2.0], 3.0],
    "complex numbers": [1j, 2, 3],
    "a complex array": np.ones(3, complex),
    "a complex array without imaginary part": jnp.ones(3, complex),
    "objects": [object(), 2, 3],
    "nothing": [None, 2, 3],
    "nothing at all": None,
    "a dictionary": {"angle": 1},
    "a set": {1, 2, 3},
    "a generator": (number for number in (1, 2, 3)),
    "times": np.zeros(3, "datetime64[s]"),
    "durations": np.zeros(3, "timedelta64[s]"),
    "named columns": np.zeros(3, [("a", float)]),
    "decimals": [Decimal(1), 2, 3],
    "a number of 400 digits": [10**400, 2, 3],
}


@pytest.mark.parametrize("name", NO_NUMBERS)
def test_what_are_no_real_numbers_is_refused(name: str):
    with pytest.raises(ArgumentError, match="state: wanted .*numbers") as caught:
        LAYOUT.check(NO_NUMBERS[name], "state")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize(
    "value",
    [
        [1, 2, 3],
        (1.0, 2.0, 3.0),
        np.array([1, 2, 3], np.float32),
        np.array([1, 2, 3], np.uint8),
        np.array([1, 2, 3], np.longdouble),
        np.array([1, 2, 3], ">f4"),
        jnp.array([1.0, 2.0, 3.0]),
        jnp.array([1.0, 2.0, 3.0], jnp.bfloat16),
        [jnp.float32(1), np.float64(2), 3],
        np.array([1.0, 9, 2, 9, 3])[::2],
    ],
)
def test_real_numbers_of_any_kind_are_taken(value: object):
    found = LAYOUT.check(value, "state")  # pyright: ignore[reportArgumentType]
    assert found.dtype == np.float64
    np.testing.assert_array_equal(found, [1, 2, 3])


def test_a_long_double_beyond_double_precision_is_not_finite():
    with pytest.raises(ArgumentError, match="not finite"):
        LAYOUT.check(np.full(3, "1e4000", np.longdouble), "state")


def test_an_emulator_refuses_text_as_state_and_complex_controls(shipped: Emulator):
    rest, still = shipped.rest, np.zeros((4, 3))
    with pytest.raises(ArgumentError, match="state: wanted real numbers"):
        shipped.rollout(["a"] * 6, still)
    with pytest.raises(ArgumentError, match="controls: wanted real numbers"):
        shipped.rollout(rest, still + 1j)
    with pytest.raises(ArgumentError, match="controls: wanted numbers in rows equally long"):
        shipped.rollout(rest, [[0.0], [0.0, 1.0]])


def test_a_system_refuses_text_as_starts():
    with pytest.raises(ArgumentError, match="state: wanted real numbers"):
        load_system("pendulum").simulate(np.array([["0"] * 6]), np.zeros((1, 1, 3)), 0.05)


def test_a_cost_refuses_text_as_a_place():
    with pytest.raises(ArgumentError, match="position: wanted real numbers"):
        reach_position(load_system("lander"), ["a", "b", "c"], within=0.1)


@pytest.mark.parametrize("duration", [float("nan"), float("inf"), -1.0, 0.0, 1e300])
def test_a_time_that_is_none_is_refused(duration: float):
    with pytest.raises(ArgumentError, match="dt: wanted a finite time"):
        Scheme("rk4", 0.001).steps(duration)


@pytest.mark.parametrize("text", ["", "a", "1,,2", "1.5", "9" * 5_000, "x" * 100_000])
def test_a_list_on_the_command_line_is_refused_in_a_short_line(text: str):
    with pytest.raises(ArgumentError, match="widths: wanted numbers such as 96,64") as caught:
        whole_numbers("widths", text)
    assert len(str(caught.value)) < 120


def test_no_parser_reads_around_the_guarded_places():
    root = Path(__file__).parents[2]
    sources = (root / "src" / "neuroanimator", root / "studio" / "neuroanimator_studio")
    readers = (
        "tomllib.load",
        "json.load",
        "np.load",
        "csv.reader",
        "zipfile.ZipFile",
        "safetensors.numpy.load",
    )
    readers += ("model_validate_json(path", "genfromtxt", "loadtxt", "pickle")
    for path in (path for source in sources for path in source.rglob("*.py")):
        if path.parent.name != "files":
            text = path.read_text(encoding="utf-8")
            assert not [reader for reader in readers if f"{reader}(" in text], path
