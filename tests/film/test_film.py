"""Films: what may be asked for, and where the camera is."""

from __future__ import annotations

import subprocess
from dataclasses import replace
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from conftest import Cli
from soft_bodies import soft_clip, wavy_shapes

from neuroanimator import Clip, Emulator, load_emulator, load_system, make_clip, write_video
from neuroanimator.animation.motion import default_drive, random_drive
from neuroanimator.control.objective.goals import is_reached
from neuroanimator.errors import ArgumentError
from neuroanimator.film.bounding_boxes import bounding_boxes
from neuroanimator.film.camera import FIELD_OF_VIEW, take_shots
from neuroanimator.film.footer import CURVE_SHARE
from neuroanimator.film.graphics import graphics_backend
from neuroanimator.film.options import CAMERAS, Film, Take, read_film
from neuroanimator.systems.system import System


def held(name: str, heights: np.ndarray, speed: float = 1.0) -> Clip:
    """Return a stiff body that goes along X at `speed` [m/s], its middle at `heights` (F,) [m]."""
    system = load_system(name)
    states = np.repeat(system.rest[None], len(heights), axis=0)
    times = np.arange(len(heights)) / 30
    assert system.structure.cloud is not None
    size = 3 * system.structure.cloud.count
    states[:, 0:size:3] += speed * times[:, None]
    states[:, 2:size:3] += heights[:, None] - system.rest[2:size:3].mean()
    return Clip(name, system.skeleton, times, states)


def share_of_width(clip: Clip, film: Film) -> float:
    """Return how much of the picture's width the body takes in the middle image."""
    shots, boxes, frame = (
        take_shots(Take((clip,)), film),
        bounding_boxes([clip]),
        len(clip.times) // 2,
    )
    azimuth, _, distance = shots.angles(frame)
    extent = boxes.high[frame] - boxes.low[frame]
    wide = (
        abs(np.sin(np.radians(azimuth))) * extent[0] + abs(np.cos(np.radians(azimuth))) * extent[1]
    )
    return wide / (
        2 * distance * np.tan(np.radians(FIELD_OF_VIEW / 2)) * film.size[0] / film.size[1]
    )


@pytest.mark.parametrize(
    ("size", "camera", "message"),
    [
        ("1281x720", "follow", "wanted even numbers of pixels between 32 and 4096.* got 1281x720"),
        ("8000x4000", "follow", "got 8000x4000"),
        ("0x720", "follow", "got 0x720"),
        ("1280", "follow", "wanted width x height in pixels, such as 1280x720, got '1280'"),
        ("1e3x720", "follow", "got '1e3x720'"),
        ("-2x720", "follow", "got '-2x720'"),
        ("9" * 5000 + "x720", "follow", "at most 4096 pixels a side"),
        (
            "1280x720",
            "drone",
            "No camera called 'drone'. Cameras: follow, side, front, back, top, still",
        ),
    ],
)
def test_a_film_nobody_can_draw_is_refused_in_one_line(size: str, camera: str, message: str):
    with pytest.raises(ArgumentError, match=message) as refusal:
        read_film(size, camera)
    assert len(str(refusal.value)) < 200
    assert "\n" not in str(refusal.value)


def test_the_command_line_refuses_a_film_before_any_work_is_done(cli: Cli, tmp_path: Path):
    done = cli("animate", "fish", "--out", tmp_path / "a.mp4", "--camera", "drone")
    assert done.returncode == 2
    assert "Cameras: follow, side" in done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("camera", list(CAMERAS))
def test_every_camera_looks_from_where_its_row_says(camera: str):
    shots = take_shots(Take((held("fish", np.ones(30)),)), Film(camera=camera))
    azimuth, elevation, _ = shots.angles(0)
    row = CAMERAS[camera]
    assert np.isclose(elevation, row.elevation)
    if camera == "follow":  # it may take another side
        assert abs(azimuth) in (48, 68, 112, 132)
    else:
        assert np.isclose((azimuth - row.azimuth + 180) % 360, 180)


@pytest.mark.parametrize("camera", [name for name in CAMERAS if name != "still"])
@pytest.mark.parametrize("height", [-4.0, -1.0, -0.35])
def test_a_dive_is_filmed_from_one_side_of_the_water(camera: str, height: float):
    heights = height + 0.1 * np.sin(np.arange(90) / 5)
    shots = take_shots(Take((held("dolphin", heights),)), Film(camera=camera), surface=0.0)
    if camera == "top":
        assert shots.position[:, 2].min() > 0  # it looks down through the surface
    else:
        assert shots.position[:, 2].max() < 0


@pytest.mark.parametrize("camera", list(CAMERAS))
def test_a_leap_is_filmed_wholly_from_above_the_water(camera: str):
    times = np.arange(120) / 30
    heights = np.where(
        times < 1.5, -3.0 + 2 * times, 5.0 * (times - 1.5) - 4.9 * (times - 1.5) ** 2
    )
    shots = take_shots(Take((held("dolphin", heights),)), Film(camera=camera), surface=0.0)
    assert shots.position[:, 2].min() > 0
    assert not shots.is_under_water


@pytest.mark.parametrize("size", [(1280, 720), (720, 1280), (640, 480)])
@pytest.mark.parametrize("name", ["fish", "dolphin", "cube"])
def test_a_body_that_goes_along_fills_half_of_the_width(name: str, size: tuple[int, int]):
    speed = 2 * float(np.ptp(load_system(name).rest[0:24:3]))
    film = Film(size, "side")
    assert 0.2 < share_of_width(held(name, np.ones(150), speed), film) <= 0.501


@pytest.mark.parametrize("name", ["truck", "lander"])
def test_a_machine_is_no_dot_in_its_landscape(name: str):
    system, times = load_system(name), np.arange(120) / 30
    states = np.repeat(system.rest[None], 120, axis=0)
    states[:, 0] += 5 * times
    assert 0.25 < share_of_width(Clip(name, system.skeleton, times, states), Film()) < 0.5


def test_the_camera_moves_smoothly_and_keeps_the_body_in_the_picture():
    rng = np.random.default_rng(0)
    clip = held("fish", 0.002 * rng.normal(size=150), 0.3)
    shots = take_shots(Take((clip,)), Film(camera="side"))
    jerks = np.abs(np.diff(shots.lookat, n=2, axis=0))
    assert (
        jerks[30:-30].max()
        < 0.2 * np.abs(np.diff(bounding_boxes([clip]).centres, n=2, axis=0)).max()
    )
    assert np.abs(shots.lookat - bounding_boxes([clip]).centres).max() < 0.5 * shots.size


def test_an_arm_that_stays_is_filmed_by_a_camera_that_stays():
    system, times = load_system("pendulum"), np.arange(60) / 30
    states = np.repeat(np.sin(times)[:, None], system.state.size, axis=1)
    shots = take_shots(Take((Clip("pendulum", system.skeleton, times, states),)), Film())
    assert np.ptp(shots.position, axis=0).max() == 0


def test_clips_that_cannot_be_seen_together_are_refused(tmp_path: Path):
    fish, cube = held("fish", np.ones(9)), held("cube", np.ones(9))
    for one, other in ((fish, cube), (cube, fish)):
        with pytest.raises(ArgumentError, match=f"one system, got {one.name} and {other.name}"):
            write_video([one, other], tmp_path / "a.mp4")
    slow = Clip("fish", fish.skeleton, fish.times * 2, fish.states)
    with pytest.raises(ArgumentError, match="wanted one rate, got 30 and 15 frames"):
        write_video([fish, slow], tmp_path / "a.mp4")
    assert not list(tmp_path.iterdir())


def test_what_a_body_wears_is_filmed_with_it(tmp_path: Path):
    """Both are in the picture: it differs from that of either alone."""
    cube = held("cube", np.ones(9))
    flag = soft_clip(wavy_shapes(12, 4), frames=9)
    bare = replace(
        flag.skeleton, bones=tuple(replace(bone, shapes=()) for bone in flag.skeleton.bones)
    )
    worn = replace(flag, skeleton=bare)
    pictures = []
    for number, clips in enumerate(([cube], [worn], [cube, worn])):
        film = tmp_path / f"{number}.mp4"
        write_video(clips, film, size=(64, 64), camera="still")
        pictures.append(first_picture(film, (64, 64)).astype(int))
    assert np.abs(pictures[2] - pictures[0]).max() > 40
    assert np.abs(pictures[2] - pictures[1]).max() > 40


def first_picture(film: Path, size: tuple[int, int]) -> np.ndarray:
    """Return the first picture (H, W, 3) of a film of that width and height."""
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-i", str(film), "-frames:v", "1"]
    raw = subprocess.run(
        [*command, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"], capture_output=True, check=True
    ).stdout
    return np.frombuffer(raw, np.uint8).reshape(size[1], size[0], 3).astype(float)


def test_the_surface_of_the_sea_casts_no_shadow_on_its_bed(tmp_path: Path):
    if graphics_backend() is None:
        pytest.skip("no OpenGL here")
    film = tmp_path / "a.mp4"
    write_video(held("dolphin", np.full(2, -1.6), 0.0), film, size=(160, 90))
    image = first_picture(film, (160, 90)).mean(axis=2)
    corners = np.array(
        [image[:12, :12], image[:12, -12:], image[-12:, :12], image[-12:, -12:]]
    ).mean(axis=(1, 2))
    assert corners[2:].min() > 110  # in the surface's shadow the bed was at 76


def centres_of(system: System, states: np.ndarray) -> np.ndarray:
    """Return the mean (K, 3) of the mass points in states (K, S)."""
    assert system.structure.cloud is not None
    points = states[:, : 3 * system.structure.cloud.count].reshape(len(states), -1, 3)
    return points.mean(axis=1)


def test_a_default_swim_stays_level():
    dolphin = load_emulator("dolphin")
    states = random_drive(dolphin, 5.0, seed=0).motion(dolphin)
    centres = centres_of(load_system("dolphin"), states)
    assert centres[:, 2].min() > -2.2
    assert centres[:, 2].max() < -1.0
    assert np.linalg.norm(centres[-1, :2] - centres[0, :2]) > 1.0


def test_a_soft_body_on_the_ground_is_thrown(untrained_cube: Emulator):
    system = load_system("cube")
    dt = untrained_cube.dt
    thrown = random_drive(untrained_cube, dt, seed=0).motion(untrained_cube)[0]
    left_alone = np.zeros((1, round(5.0 / dt), system.control.size))
    states = system.simulate(thrown[None], left_alone, dt, scheme=system.scheme).states[0]
    centres = centres_of(system, states)
    assert centres[:, 2].min() > 0.1
    assert centres[:, 2].max() < 0.9
    assert np.linalg.norm(centres[-1, :2] - centres[0, :2]) > 1.0


@pytest.mark.parametrize(
    ("name", "goal"), [("truck-50", "bay_2"), ("lander-50", "pad"), ("pendulum-50", "upright")]
)
def test_a_machine_shows_how_it_reaches_a_goal(name: str, goal: str):
    emulator = load_emulator(name)
    states = default_drive(emulator).motion(emulator)
    assert is_reached(load_system(emulator.system), goal, states[-1])


def test_a_dolphin_shows_a_leap_at_every_super_step():
    for name in ("dolphin-25", "dolphin-50", "dolphin-100"):
        emulator = load_emulator(name)
        heights = default_drive(emulator).motion(emulator)[:, 2 : 3 * 23 : 3]
        assert heights.min(axis=1).max() > 0, name  # all of it is out of the water
        assert heights.mean(axis=1)[-1] < 0.2, name


def test_a_body_glows_where_it_is_not_to_be_believed_and_a_curve_says_so(tmp_path: Path):
    if graphics_backend() is None:
        pytest.skip("no OpenGL to draw with")
    emulator = load_emulator("lander-50")
    states = np.repeat(emulator.rest[None], 2, axis=0)
    pictures = []
    for score in (0.2, 9.0):
        clip = make_clip(emulator, states, trust=[score])
        path = tmp_path / "lander.mp4"
        write_video(clip, path, size=(160, 90))
        pictures.append(first_picture(path, (160, 90)))
    sure, lost = pictures
    strip = round(CURVE_SHARE * 90)
    difference = lost - sure
    body = difference[: -strip - 8]
    assert body[..., 0].max() > 40  # redder
    assert body[..., 2].min() < -10
    assert np.abs(body).max(axis=2).mean() < 20  # and nothing else
    assert np.abs(difference[-strip:]).mean() > 5


def test_trust_shown_is_a_score_a_super_step():
    emulator = load_emulator("lander-50")
    states = np.repeat(emulator.rest[None], 5, axis=0)
    clip = make_clip(emulator, states, rate=3 / emulator.dt, trust=[0.0, 1.0, 2.0, 3.0])
    assert clip.trust is not None
    assert clip.trust.tolist() == [0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3, 3]
    with pytest.raises(ArgumentError, match="wanted a score for each of 4 super steps"):
        make_clip(emulator, states, trust=[1.0])
