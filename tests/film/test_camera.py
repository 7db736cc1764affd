"""Where the camera of a film is: what moves is seen to move, and is in the middle."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from jaxtyping import Float

from neuroanimator import load_emulator, load_policy, load_system, make_clip
from neuroanimator.animation.clip import Clip
from neuroanimator.animation.motion import default_drive
from neuroanimator.control.policies.school import school_motion
from neuroanimator.film.bounding_boxes import BoundingBoxes, bounding_boxes, fixed_boxes
from neuroanimator.film.camera import FIELD_OF_VIEW, MAX_HIDDEN, Shots, hidden_share, take_shots
from neuroanimator.film.options import Film, Take

FILM = Film()


def seen_at(shots: Shots, points: Float[np.ndarray, "F 3"]) -> Float[np.ndarray, "F 2"]:
    """Return where points are in the picture, to the right and up from its middle, over its width."""
    ahead = shots.lookat - shots.position
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    offsets = points - shots.position
    depth = (offsets * ahead).sum(axis=1)
    upward = np.cross(right, ahead)
    aside = np.stack([(offsets * right).sum(axis=1), (offsets * upward).sum(axis=1)], axis=1)
    width = 2 * np.tan(np.radians(FIELD_OF_VIEW) / 2) * FILM.size[0] / FILM.size[1]
    return aside / depth[:, None] / width


def middle_of(clip: Clip) -> Float[np.ndarray, "F 3"]:
    positions, _ = clip.skeleton.world_poses(clip.states)
    return positions.mean(axis=1)


def test_the_beat_of_a_fishs_tail_is_seen():
    emulator = load_emulator("fish")
    clip = make_clip(emulator, default_drive(emulator).motion(emulator))
    positions, _ = clip.skeleton.world_poses(clip.states)
    tail = int(positions[0, :, 0].argmin())
    shots = take_shots(Take((clip,)), FILM)
    beat = seen_at(shots, positions[:, tail]) - seen_at(shots, middle_of(clip))
    sweep = np.linalg.norm(np.ptp(beat[30:], axis=0))
    assert sweep > 0.06


def test_a_dolphin_that_leaps_is_seen_from_its_side():
    emulator = load_emulator("dolphin")
    clip = make_clip(emulator, default_drive(emulator).motion(emulator))
    azimuth, _, _ = take_shots(Take((clip,)), FILM, surface=0.0).angles(0)
    assert abs(azimuth) > 45


@pytest.mark.parametrize("system", ["truck", "lander"])
def test_nothing_fixed_stands_before_what_is_filmed(system: str):
    emulator = load_emulator(system)
    clip = make_clip(emulator, default_drive(emulator).motion(emulator))
    obstacles = fixed_boxes(clip)
    assert len(obstacles.low)
    shots = take_shots(Take((clip,)), FILM)
    assert hidden_share(shots.position, bounding_boxes([clip]), obstacles) <= MAX_HIDDEN


def test_a_wall_hides_what_is_behind_it_and_nothing_before_it():
    body = BoundingBoxes(np.array([[9.0, -1, 0]]), np.array([[11.0, 1, 2]]))
    wall = BoundingBoxes(np.array([[4.0, -5, 0]]), np.array([[5.0, 5, 5]]))
    for camera, share in (([0.0, 0, 1], 1.0), ([7.0, 0, 1], 0.0), ([20.0, 0, 1], 0.0)):
        assert hidden_share(np.array([camera]), body, wall) == share


def test_a_school_is_followed_and_stays_in_the_middle_of_the_picture():
    policy = load_policy("fish")
    clips = [make_clip(policy.emulator, states) for states in school_motion(policy, 12)]
    shots = take_shots(Take(tuple(clips)), FILM)
    middle = np.mean([middle_of(clip) for clip in clips], axis=0)
    assert np.abs(seen_at(shots, middle)).max() < 0.05


@pytest.mark.parametrize("name", ["dolphin", "fish", "lander", "pendulum", "truck"])
def test_all_of_a_body_is_in_every_picture(name: str):
    emulator = load_emulator(name)
    clip = make_clip(emulator, default_drive(emulator).motion(emulator))
    surface = load_system(name).water_surface
    shots = take_shots(Take((clip,)), FILM, surface)
    boxes = bounding_boxes([clip])
    corners = [np.where(c, boxes.high, boxes.low) for c in itertools.product((0, 1), repeat=3)]
    seen = np.abs([seen_at(shots, corner) for corner in corners])
    assert seen[..., 0].max() < 0.5
    assert seen[..., 1].max() < 0.5 * FILM.size[1] / FILM.size[0]
