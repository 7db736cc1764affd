"""Numbers are held against their column and their file: read as they were meant, or refused, never off by a factor."""

from __future__ import annotations

import io
from collections.abc import Callable

import numpy as np
import pytest

from neuroanimator.errors import BadFileError
from neuroanimator.physics.recorded.recording import Recording, parse_recording
from neuroanimator.state.rotation import multiply

HEADER = [
    "time s",
    "state.place m",
    "state.angle rad",
    "state.angle.velocity rad/s",
    "control.pressure Pa",
]

Cells = list[list[str]]


def numbers(seed: int, rows: int = 150) -> np.ndarray:
    """Return a motion whose numbers go from thousandths to thousands, under changing controls."""
    rng = np.random.default_rng(seed)
    times = np.arange(rows) / 50
    rate = rng.uniform(2, 4)
    place = 2500 * np.sin(rng.uniform(1, 3) * times) * rng.uniform(0.5, 1)
    angle = 0.4 * np.sin(rate * times)
    velocity = 0.4 * rate * np.cos(rate * times)
    pressure = np.repeat(rng.uniform(-150_000, 150_000, rows // 10), 10)
    return np.stack([times, place, angle, velocity, pressure], axis=1)


def grouped(value: float, decimals: int = 4, thousands: str = ",", decimal: str = ".") -> str:
    text = f"{value:,.{decimals}f}"
    return text.replace(",", "\0").replace(".", decimal).replace("\0", thousands)


def joined(cells: Cells, delimiter: str, header: list[str] = HEADER) -> bytes:
    """Return a table; cells that hold the delimiter are quoted."""
    lines = [delimiter.join(header)]
    for row in cells:
        quoted = [f'"{cell}"' if delimiter in cell else cell for cell in row]
        lines.append(delimiter.join(quoted))
    return "\n".join(lines).encode()


def written(
    table: np.ndarray, delimiter: str, thousands: str, decimal: str, decimals: int = 4
) -> bytes:
    cells = [
        [grouped(value, decimals, thousands, decimal) for value in row] for row in table.tolist()
    ]
    return joined(cells, delimiter)


def plain(table: np.ndarray, decimals: int = 4) -> Recording:
    return parse_recording(written(table, ",", "", ".", decimals), "plain.csv")


def assert_same(found: Recording, expected: Recording, atol: float = 0.0) -> None:
    assert found.step == expected.step
    assert found.state == expected.state
    for states, wanted in zip(found.states, expected.states, strict=True):
        np.testing.assert_allclose(states, wanted, rtol=0, atol=atol)
    for controls, wanted in zip(found.controls, expected.controls, strict=True):
        np.testing.assert_allclose(controls, wanted, rtol=1e-15, atol=atol)


@pytest.mark.parametrize(
    ("delimiter", "thousands", "decimal"),
    [
        (",", ",", "."),
        (",", " ", "."),
        (",", "'", "."),
        (",", "", ","),
        (";", ".", ","),
        (";", ",", "."),
        (";", "", ","),
        (";", "\u202f", ","),
        (";", "\u00a0", ","),
        ("\t", ".", ","),
        ("\t", ",", "."),
    ],
)
@pytest.mark.parametrize("decimals", [2, 3, 4])
def test_marks_of_thousands_and_decimals_say_the_same_number(
    delimiter: str, thousands: str, decimal: str, decimals: int
):
    for seed in range(3):
        table = numbers(seed)
        content = written(table, delimiter, thousands, decimal, decimals)
        assert_same(parse_recording(content, "a.csv"), plain(table, decimals))


@pytest.mark.parametrize("delimiter", [";", "\t"])
def test_a_mark_that_may_be_either_is_read_as_its_file_says_or_refused(delimiter: str):
    # 1,234 is a thousand beside 0.02, and a little more than one beside 0,02.
    head = ["time s", "state.place m"]
    for decimal, value in ((".", 1234.0), (",", 1.234)):
        cells = [[f"0{decimal}{2 * k:02d}", "1,234"] for k in range(5)]
        found = parse_recording(joined(cells, delimiter, head), "a.csv")
        assert (found.states[0] == value).all()
    cells = [[f"{1 + k},500", "1,234"] for k in range(5)]
    with pytest.raises(BadFileError, match="'1,500' in line 2 may be a thousand times as large"):
        parse_recording(joined(cells, delimiter, head), "a.csv")


def test_numbers_that_contradict_each_other_are_refused_with_their_lines():
    cells = [[f"{k / 50:.2f}", "0.5"] for k in range(9)]
    cells[4][1] = "0,5"
    with pytest.raises(BadFileError, match=r"'0.00' in line 2 and '0,5' in line 6"):
        parse_recording(joined(cells, ";", ["time s", "state.place m"]), "a.csv")


@pytest.mark.parametrize(
    "cell", ["", "nan", "NaN", "inf", "-", "n/a", "ok", "1.2.3", "12,34", "1,2345", "0x10", "1 2"]
)
@pytest.mark.parametrize("delimiter", [",", ";"])
def test_a_cell_that_is_no_number_is_refused_by_line_and_column(cell: str, delimiter: str):
    cells = [[grouped(value, 4, "", ".") for value in row] for row in numbers(0).tolist()]
    cells[7][2] = cell
    with pytest.raises(BadFileError) as caught:
        parse_recording(joined(cells, delimiter), "a.csv")
    assert "line 9" in str(caught.value)
    assert "\n" not in str(caught.value)


UNITS = {
    "deg": ("rad", np.pi / 180), "°": ("rad", np.pi / 180), "deg/s": ("rad/s", np.pi / 180),
    "rpm": ("rad/s", np.pi / 30), "mm": ("m", 1e-3), "cm": ("m", 1e-2), "kPa": ("Pa", 1e3),
}  # fmt: skip


@pytest.mark.parametrize("form", ["{} {}", "{} [{}]", "{} ({})", "{}[{}]"])
def test_other_units_in_a_header_are_converted(form: str):
    table = numbers(1)
    for unit, (inside, factor) in UNITS.items():
        header = []
        scaled = table.copy()
        for column, cell in enumerate(HEADER):
            name, own = cell.split(" ")
            if own == inside:
                scaled[:, column] /= factor
                own = unit
            header.append(form.format(name, own))
        cells = [[repr(value) for value in row] for row in scaled.tolist()]
        found = parse_recording(joined(cells, ",", header), "a.csv")
        assert any("converted" in remark for remark in found.remarks)
        cells = [[repr(value) for value in row] for row in table.tolist()]
        expected = parse_recording(joined(cells, ","), "plain.csv")
        assert_same(found, expected, atol=1e-9)


def in_npz(table: np.ndarray, names: list[str]) -> bytes:
    content = io.BytesIO()
    np.savez(content, time=table[:, 0], states=table[:, 1:], state_names=names)
    return content.getvalue()


def in_csv(table: np.ndarray, names: list[str]) -> bytes:
    cells = [[repr(value) for value in row] for row in table.tolist()]
    return joined(cells, ",", ["time s", *(f"state.{name}" for name in names)])


FORMATS: dict[str, Callable[[np.ndarray, list[str]], bytes]] = {"a.csv": in_csv, "a.npz": in_npz}


@pytest.mark.parametrize("file", FORMATS)
@pytest.mark.parametrize("wrong", [2, 3])
def test_degrees_that_claim_radians_are_refused(file: str, wrong: int):
    rng = np.random.default_rng(0)
    for seed in range(3):
        table = numbers(seed)[:, :4]
        table[:, wrong] *= 180 / np.pi
        table += 1e-3 * table.std(axis=0) * rng.normal(size=table.shape) * [0, 1, 1, 1]
        names = ["place m", "angle rad", "angle.velocity rad/s"]
        with pytest.raises(BadFileError, match=f"'{names[wrong - 1]}' looks like degrees"):
            parse_recording(FORMATS[file](table, names), file)


@pytest.mark.parametrize("file", FORMATS)
def test_an_angle_that_jumps_by_whole_turns_of_degrees_is_refused(file: str):
    times = np.arange(200) / 50
    angle = (200 * times + 180) % 360 - 180
    content = FORMATS[file](np.stack([times, angle], axis=1), ["angle rad"])
    with pytest.raises(BadFileError, match="'angle rad' looks like degrees"):
        parse_recording(content, file)


@pytest.mark.parametrize("ratio", [1.0, 10.0, 50.0, 64.0, 100.0])
def test_a_gear_is_not_taken_for_degrees(ratio: float):
    table = numbers(0)[:, :4]
    table[:, 3] *= ratio
    names = ["place m", "angle rad", "motor.velocity rad/s"]
    found = parse_recording(in_csv(table, names), "a.csv")
    np.testing.assert_array_equal(found.states[0], table[:, 1:])


@pytest.mark.parametrize("file", FORMATS)
@pytest.mark.parametrize(
    "names", [["qw", "qx", "qy", "qz"], ["hand_x", "hand_y", "hand_z", "hand_w"], list("0123")]
)
def test_signs_of_a_quaternion_mean_nothing(file: str, names: list[str]):
    if names[0] == "0":
        names = [f"orientation.{number}" for number in names]
    rng = np.random.default_rng(1)
    times = np.arange(300) / 60
    turn = 2.5 * times
    tilt = 0.3 * np.sin(3 * times)
    zero = 0 * times
    yaw = np.stack([np.cos(turn / 2), zero, zero, np.sin(turn / 2)], axis=1)
    roll = np.stack([np.cos(tilt / 2), np.sin(tilt / 2), zero, zero], axis=1)
    rotations = multiply(yaw, roll)
    units = [f"{name} 1" for name in [*names, "height"]]
    ways = {
        "positive": np.where(rotations[:, :1] < 0, -1.0, 1.0),
        "any": rng.choice([-1.0, 1.0], size=(len(times), 1)),
        "none": np.ones((len(times), 1)),
    }
    ways["any"][0] = 1
    height = times[:, None] / 9
    for way, signs in ways.items():
        table = np.hstack([times[:, None], signs * rotations, height])
        found = parse_recording(FORMATS[file](table, units), file)
        np.testing.assert_array_equal(found.states[0], np.hstack([rotations, height]))
        assert any("sign" in remark for remark in found.remarks) == (way != "none")


def test_every_run_begins_on_the_same_side_of_a_quaternion():
    angles = np.tile(np.linspace(0.1, 0.6, 50), 2)
    zero = np.zeros(100)
    rotations = np.stack([np.cos(angles / 2), zero, zero, np.sin(angles / 2)], axis=1)
    rotations[50:] *= -1
    times = np.tile(np.arange(50) / 50, 2)
    table = np.hstack([times[:, None], rotations])
    found = parse_recording(in_csv(table, ["qw 1", "qx 1", "qy 1", "qz 1"]), "a.csv")
    np.testing.assert_array_equal(found.states[0], found.states[1])


def test_four_numbers_that_are_no_rotation_keep_their_signs():
    rng = np.random.default_rng(0)
    table = np.hstack([np.arange(60)[:, None] / 50, rng.normal(size=(60, 4))])
    found = parse_recording(in_csv(table, ["qw 1", "qx 1", "qy 1", "qz 1"]), "a.csv")
    np.testing.assert_array_equal(found.states[0], table[:, 1:])
