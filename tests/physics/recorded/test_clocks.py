"""A clock is judged by what its times can mean, however they were written; what departs from it is placed, and mended."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from neuroanimator import load_system
from neuroanimator.animation.recorded_path import read_path
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.physics.loading import resolve
from neuroanimator.physics.recorded.read_recordings import read_recordings
from neuroanimator.physics.recorded.recorded_system import RecordedSystem
from neuroanimator.physics.recorded.recording import Recording, parse_recording
from neuroanimator.scaffold.write_toml import write_definition

RATES = (24.0, 29.97, 30.0, 50.0, 59.94, 60.0, 90.0, 100.0, 119.88, 120.0, 240.0, 999.7, 1000.0)
"""Usual rates of cameras, games, sensors [1/s]."""

EPOCH = 1.7328e9
"""Seconds from 1970 to a recording."""

Write = Callable[[np.ndarray], tuple[bytes, str]]
"""Function from times [s] to a file's bytes and its name."""


def motion(times: np.ndarray) -> np.ndarray:
    """Return an angle at `times` of any slow motion."""
    return np.sin(3 * times) + 0.3 * np.cos(7 * times)


def table(times: list[str], states: np.ndarray, head: str = "time s") -> bytes:
    rows = [f"{time},{state:.9f}" for time, state in zip(times, states, strict=True)]
    return "\n".join([f"{head},state.angle rad", *rows]).encode()


def as_csv(form: str, head: str = "time s", since: float = 0.0, factor: float = 1.0) -> Write:
    def write(times: np.ndarray) -> tuple[bytes, str]:
        texts = [format(value, form) for value in ((times + since) * factor).tolist()]
        return table(texts, motion(times), head), "a.csv"

    return write


def single(times: np.ndarray) -> tuple[bytes, str]:
    return table([str(time) for time in times.astype(np.float32)], motion(times)), "a.csv"


def trimmed(times: np.ndarray) -> tuple[bytes, str]:
    return table([repr(round(time, 3)) for time in times.tolist()], motion(times)), "a.csv"


def whole(unit: str, since: float = 0.0) -> Write:
    """Return times as whole numbers of a unit, beside their header."""
    factor = {"ms": 1e3, "us": 1e6, "ns": 1e9}[unit]

    def write(times: np.ndarray) -> tuple[bytes, str]:
        counts = [str(round((time + since) * factor)) for time in times.tolist()]
        return table(counts, motion(times), f"time [{unit}]"), "a.csv"

    return write


def as_npz(convert: Callable[[np.ndarray], np.ndarray], key: str = "time") -> Write:
    def write(times: np.ndarray) -> tuple[bytes, str]:
        content = io.BytesIO()
        states = motion(times)[:, None]
        arrays = {key: convert(times), "states": states, "state_names": np.array(["angle rad"])}
        np.savez(content, **arrays)  # pyright: ignore
        return content.getvalue(), "a.npz"

    return write


WAYS: dict[str, Write] = {
    "milliseconds": as_csv(".3f"),
    "milliseconds without zeros": trimmed,
    "milliseconds since 1970": as_csv(".3f", since=EPOCH),
    "tenths of milliseconds": as_csv(".4f"),
    "six decimals": as_csv(".6f"),
    "nine digits": as_csv(".9g"),
    "all digits": as_csv(".17g"),
    "powers of ten": as_csv(".6e"),
    "single precision": single,
    "epoch in double precision": as_csv(".17g", since=EPOCH),
    "milliseconds with decimals": as_csv(".2f", "time (ms)", factor=1e3),
    "whole milliseconds": whole("ms"),
    "whole microseconds": whole("us"),
    "whole nanoseconds": whole("ns"),
    "nanoseconds since 1970": whole("ns", EPOCH),
    "NPZ": as_npz(lambda times: times),
    "NPZ rounded": as_npz(lambda times: np.round(times, 3)),
    "NPZ since 1970": as_npz(lambda times: times + EPOCH),
    "NPZ in single precision": as_npz(lambda times: times.astype(np.float32)),
    "NPZ late in single precision": as_npz(lambda times: (times + 900).astype(np.float32)),
    "NPZ in nanoseconds": as_npz(lambda times: np.round(times * 1e9).astype(np.int64)),
    "NPZ in named nanoseconds": as_npz(
        lambda times: np.round((times + EPOCH) * 1e9).astype(np.uint64), "time_ns"
    ),
    "NPZ in named milliseconds": as_npz(
        lambda times: np.round(times * 1e3).astype(np.int32), "time_ms"
    ),
    "NPZ of dates": as_npz(
        lambda times: np.datetime64("2026-11-28") + np.round(times * 1e9).astype("timedelta64[ns]")
    ),
}
"""Ways to write the times of a recording."""


def read(written: tuple[bytes, str], *, is_resampled: bool = False) -> Recording:
    return parse_recording(*written, is_resampled=is_resampled)


@pytest.mark.parametrize("way", WAYS)
def test_a_constant_rate_is_constant_however_its_times_are_written(way: str):
    rng = np.random.default_rng(0)
    for rate in RATES:
        count = int(rng.integers(300, 1500))
        times = np.arange(count) / rate
        found = read(WAYS[way](times))
        assert [len(states) for states in found.states] == [count]
        # A millisecond at the end, at most: what the times tell.
        assert found.step == pytest.approx(1 / rate, rel=3e-3 * rate / count + 1e-6)
        if rate == int(rate):
            assert found.step == 1 / rate
        np.testing.assert_allclose(found.states[0][:, 0], motion(times), atol=1e-8)


def test_rounding_does_not_hide_that_samples_jitter():
    rng = np.random.default_rng(1)
    for rate in (50.0, 60.0, 120.0):
        times = np.arange(600) / rate
        late = times + rng.uniform(-0.2, 0.2, len(times)) / rate
        for form in (".3f", ".6f", ".17g"):
            with pytest.raises(BadFileError, match=r"jitters.*line \d+.*--resample") as caught:
                read(as_csv(form)(late))
            told = re.search(r"on average [\d.]+ s \(([\d.]+) a second\)", str(caught.value))
            assert told is not None
            assert float(told[1]) == pytest.approx(rate, rel=2e-3)


@pytest.mark.parametrize("form", [".3f", ".6f", ".17g"])
def test_gaps_are_counted_and_the_first_is_named_by_line(form: str):
    rng = np.random.default_rng(2)
    for rate in (30.0, 60.0, 100.0, 120.0):
        times = np.arange(500) / rate
        first = int(rng.integers(20, 200))
        lost = [first, 300, 301, 302, 400]
        with pytest.raises(BadFileError) as caught:
            read(as_csv(form)(np.delete(times, lost)))
        message = str(caught.value)
        # Line 1 is the header, and `first` rows come before.
        assert f"a.csv, line {first + 2}, time:" in message
        assert "3 such intervals, 0.61 % of all" in message
        assert f"elsewhere {1 / rate:.6g} s" in message
        repeated = np.insert(times, first, times[first])
        with pytest.raises(BadFileError, match=rf"line {first + 3}, time: 0 s after"):
            read(as_csv(form)(repeated))


def test_resampling_puts_a_jittering_motion_where_it_was():
    rng = np.random.default_rng(3)
    for rate in (50.0, 120.0):
        times = np.arange(600) / rate
        late = times + rng.uniform(-0.2, 0.2, len(times)) / rate
        found = read(as_csv(".6f")(late), is_resampled=True)
        (states,) = found.states
        even = late[0] + found.step * np.arange(len(states))
        np.testing.assert_allclose(states[:, 0], motion(even), atol=1e-4)
        assert any("resampled" in remark for remark in found.remarks)


def test_resampling_bridges_short_gaps_and_begins_a_run_after_long_ones():
    times = np.arange(600) / 100
    times = np.delete(times, [50, *range(300, 340)])
    found = read(as_csv(".3f")(np.insert(times, 20, times[20])), is_resampled=True)
    assert [len(states) for states in found.states] == [300, 260]
    assert found.step == 0.01
    np.testing.assert_allclose(found.states[0][:, 0], motion(np.arange(300) / 100), atol=1e-4)
    np.testing.assert_allclose(found.states[1][:, 0], motion(3.4 + np.arange(260) / 100), atol=1e-4)
    assert found.origins == ("line 2", "line 302")


def test_controls_are_resampled_by_the_time_that_they_acted():
    rng = np.random.default_rng(4)
    times = np.arange(400) / 50 + np.concatenate([[0], rng.uniform(-0.005, 0.005, 399)])
    held = np.repeat(rng.uniform(-1, 1, 40), 10)
    rows = [
        f"{time:.6f},{motion(np.array(time)):.6f},{control:.6f}"
        for time, control in zip(times, held, strict=True)
    ]
    header = "time s,state.angle rad,control.torque N·m"
    found = read(("\n".join([header, *rows]).encode(), "a.csv"), is_resampled=True)
    acted = (held[:-1] * np.diff(times)).sum()
    (controls,) = found.controls
    assert (controls[:-1] * found.step).sum() == pytest.approx(acted, abs=0.02)


def test_a_rate_that_changes_is_refused():
    times = np.concatenate([np.arange(300) / 100, 3 + np.arange(300) / 90])
    with pytest.raises(BadFileError, match="drifts or jitters"):
        read(as_csv(".3f")(times))


@pytest.mark.parametrize(
    ("written", "message"),
    [
        (as_npz(lambda times: (times + EPOCH).astype(np.float32)), "no less than 128 s apart"),
        (as_csv(".0f", factor=1e9), "Name their unit"),
        (as_csv(".0f", "time", factor=1e3), "Name their unit"),
        (as_npz(lambda times: np.round(times * 1e3).astype(int)), "Name their unit"),
        (as_csv(".0f"), "no less than 1 s apart"),
    ],
)
def test_times_that_tell_no_rate_or_no_unit_are_refused(written: Write, message: str):
    with pytest.raises(BadFileError, match=message):
        read(written(np.arange(400) / 120))


def test_what_new_resamples_is_resampled_by_all_that_follows(tmp_path: Path):
    rng = np.random.default_rng(5)
    times = np.arange(2000) / 100 + rng.uniform(-0.002, 0.002, 2000)
    path = tmp_path / "uneven.csv"
    path.write_bytes(as_csv(".5f")(times)[0])
    with pytest.raises(BadFileError, match="--resample"):
        write_definition(str(path))
    toml, proposal = write_definition(str(path), resample=True)
    assert "resample = true" in toml.read_text()
    assert any("resampled" in line for _, line in proposal.told)
    system = load_system(*resolve(str(toml))[:2])
    assert isinstance(system, RecordedSystem)
    assert system.recordings is not None
    even = read_recordings(system.recordings)
    expected = parse_recording(path.read_bytes(), path.name, is_resampled=True)
    np.testing.assert_array_equal(even.states[0], expected.states[0])
    (tmp_path / "step.py").write_text("")
    with pytest.raises(ArgumentError, match="are for recordings"):
        write_definition(str(tmp_path / "step.py"), resample=True)


def test_a_path_in_milliseconds_has_the_speed_of_its_motion(tmp_path: Path):
    times = np.arange(240) / 120
    rows = [f"{time:.3f},{2 * time:.6f},0,0" for time in times]
    path = tmp_path / "walk.csv"
    path.write_text("\n".join(["time,x,y,z", *rows]))
    read = read_path(path)
    speeds = np.diff(read.positions[:, 0]) / np.diff(read.times)
    np.testing.assert_allclose(speeds, 2, rtol=1e-3)
