"""The worst cases of an emulator as a film or as curves; what cannot be drawn is refused before any work is done."""

from __future__ import annotations

import subprocess
from dataclasses import replace
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from conftest import Cli

from neuroanimator import Emulator, inspect, write_worst
from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.errors import ResourceError
from neuroanimator.film import worst_cases
from neuroanimator.film.footer import caption_image
from neuroanimator.film.graphics import graphics_backend
from neuroanimator.film.inline import film_html
from neuroanimator.film.worst_cases import _takes
from neuroanimator.learn.evaluation.weakness.inspection import Inspection


@pytest.fixture(scope="module")
def found(shipped: Emulator) -> Inspection:
    inspection = inspect(shipped, runs=4)
    return replace(inspection, worst=inspection.worst[:2])


@pytest.fixture(scope="module")
def without_bodies(shipped: Emulator) -> Emulator:
    return replace(shipped, spec=replace(shipped.spec, skeleton=Skeleton(())))


def test_a_film_shows_every_worst_case_at_half_its_speed(
    shipped: Emulator, found: Inspection, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    if graphics_backend() is None:
        with pytest.raises(ResourceError, match="No OpenGL"):
            write_worst(shipped, found, tmp_path / "worst.mp4")
        return
    monkeypatch.setattr(worst_cases, "SIZE", (64, 36))
    monkeypatch.setattr(worst_cases, "RATE", 6.0)
    write_worst(shipped, found, tmp_path / "worst.mp4")
    ffmpeg = imageio_ffmpeg.get_ffmpeg_exe()
    raw = subprocess.run(
        [ffmpeg, "-loglevel", "error", "-i", tmp_path / "worst.mp4", "-f", "rawvideo", "-"],
        capture_output=True,
        check=True,
    ).stdout
    seconds = len(found.worst) * (2 * 1.0 + worst_cases.HELD_SECONDS)
    images = len(raw) / (64 * 36 * 3 / 2)
    assert images == pytest.approx(seconds * worst_cases.RATE, abs=2 * len(found.worst))
    page = film_html(tmp_path / "worst.mp4", "<b>of & off</b>")
    assert page.startswith("<video controls")
    assert 'src="data:video/mp4;base64,' in page
    assert "&lt;b&gt;of &amp; off" in page


@pytest.mark.parametrize("name", ["worst.svg", "worst.png"])
def test_curves_need_no_bodies(
    name: str, without_bodies: Emulator, found: Inspection, tmp_path: Path
):
    write_worst(without_bodies, found, tmp_path / name)
    first = (tmp_path / name).read_bytes()
    write_worst(without_bodies, found, tmp_path / name)
    assert (tmp_path / name).read_bytes() == first
    assert len(first) > 10_000


def test_what_has_no_bodies_is_filmed_as_gauges_of_one_range(
    without_bodies: Emulator, found: Inspection
):
    for take in _takes(without_bodies, found):
        assert take.ghost is not None
        assert len(take.clips[0].skeleton.bones) == len(take.ghost.skeleton.bones) > 0
        np.testing.assert_allclose(take.clips[0].states[0], take.ghost.states[0], atol=1e-5)


def test_the_command_line_refuses_other_endings_before_any_work_is_done(cli: Cli, tmp_path: Path):
    refused = cli("evaluate", "pendulum-50", "--worst", tmp_path / "worst.gif")
    assert refused.returncode == 2
    assert "worst: 'worst.gif' ends in none of .mp4, .png, .svg" in refused.stderr
    assert refused.stderr.count("\n") == 1


def test_an_emulator_that_comes_to_no_numbers_stays_where_it_was_last(
    shipped: Emulator, found: Inspection
):
    broken = np.array(found.worst[0].emulated)
    broken[3:] = np.nan
    segments = (replace(found.worst[0], emulated=broken),)
    [take] = _takes(shipped, replace(found, worst=segments))
    assert take.ghost is not None
    assert np.isfinite(take.ghost.states).all()
    np.testing.assert_allclose(take.ghost.states[-1], broken[2], atol=1e-6)


def test_captions_fit_and_hold_no_formulas():
    for text in ("short", "$x_{1}$ \x1b[2J " * 10):
        image = caption_image(text, 320, 12)
        assert image.shape == (12, 320, 3)
        assert image.max() > 150
        # The margins stay dark: nothing is cut off.
        assert image[:, :2].max() < 60
        assert image[:, -2:].max() < 60
