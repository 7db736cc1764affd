"""Rules of tasks that are learnt inside emulators: those of two environments of Gymnasium, and of parking a truck."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float

import neuroanimator as na
from neuroanimator.gym import EpisodeRules
from neuroanimator.learn.tasks.rigid import TRUCK_MARGIN, TRUCK_PROBES, lot_zones
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem
from neuroanimator.state.layout import Layout

Rows = Float[np.ndarray, "B N"]
Numbers = Float[np.ndarray, " B"]


BAY = np.array([-6.4, -7.3])
"""[m] The middle of bay 4 of the truck's lot."""

BAY_HEADING = -np.pi / 2
"""[rad] Nose in."""

LANE_START = (-12.8, 0.0)
"""[m] In the lane, the bay half a turn of the wheels away."""

LANE_NOISE = (1.5, 0.7, 0.3)
"""Spread of where episodes begin, along the lane [m], across it [m] and in heading [rad]."""

FAR_FROM_BAY = 14.0
"""[m] Beyond it a truck has missed the bay."""

LENGTH_SCALE = 5.0
"""[m] In which distances count."""

PARKING_STEPS = 100
"""Super steps of 0.1 s."""

TOUCH_COST = 0.5
"""What touching an obstacle costs."""


def parking_rules(emulator: na.Emulator) -> EpisodeRules:
    """Return the rules of parking nose in: come nearer, turn into the bay, stand still in it, touch nothing.

    A step earns by how much it lowered distance/5 m + (1 − cos e)/2 · exp(−distance/4 m), e being the error of heading,
    and Δt · exp(−distance/1 m − (1 − cos e)/0.2 − speed/(1 m/s)) for standing in the bay.
    """
    system = na.load_system("truck")
    assert isinstance(system, MujocoSystem)
    zones = lot_zones(system)
    centres = np.array([zone.position for zone in zones])
    halves = np.array([zone.half or (0.0, 0.0) for zone in zones])
    radii = np.array([zone.radius for zone in zones])
    along = np.array(TRUCK_PROBES)[:, 0]
    layout = emulator.state

    def offset(states: Float[np.ndarray, "B S"]) -> Float[np.ndarray, "B 2"]:
        return layout.part(states, "root.position")[:, :2] - BAY

    def heading(states: Float[np.ndarray, "B S"]) -> Float[np.ndarray, " B"]:
        w, x, y, z = layout.part(states, "root.orientation").T
        return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))

    def velocity(states: Float[np.ndarray, "B S"]) -> Float[np.ndarray, "B 2"]:
        return layout.part(states, "root.velocity")[:, :2]

    def potential(states: Float[np.ndarray, "B S"]) -> Float[np.ndarray, " B"]:
        distance = np.linalg.norm(offset(states), axis=1)
        error = 1 - np.cos(heading(states) - BAY_HEADING)
        return distance / LENGTH_SCALE + error / 2 * np.exp(-distance / 4)

    def touches(states: Float[np.ndarray, "B S"]) -> Bool[np.ndarray, " B"]:
        angle = heading(states)
        ahead = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        middle = layout.part(states, "root.position")[:, :2]
        probes = middle[:, None] + along[:, None] * ahead[:, None]
        beyond = np.maximum(np.abs(probes[:, :, None] - centres) - halves, 0)
        clearance = np.linalg.norm(beyond, axis=-1) - radii
        return np.asarray((clearance < TRUCK_MARGIN).any(axis=(1, 2)))

    def reward(
        states: Float[np.ndarray, "B S"],
        controls: Float[np.ndarray, "B C"],
        following: Float[np.ndarray, "B S"],
        dt: float,
    ) -> Float[np.ndarray, " B"]:
        distance = np.linalg.norm(offset(following), axis=1)
        error = 1 - np.cos(heading(following) - BAY_HEADING)
        speed = np.linalg.norm(velocity(following), axis=1)
        parked = np.exp(-distance / 1.0 - error / 0.2 - speed / 1.0)
        return (
            potential(states) - potential(following) + dt * parked - TOUCH_COST * touches(following)
        )

    def is_over(states: Float[np.ndarray, "B S"]) -> Bool[np.ndarray, " B"]:
        is_far = np.linalg.norm(offset(states), axis=1) > FAR_FROM_BAY
        return touches(states) | is_far

    def observe(states: Float[np.ndarray, "B S"]) -> Float[np.ndarray, "B 10"]:
        """The bay as the truck sees it, the truck as the bay does, its velocity along its own axes, and its wheels."""
        angle = heading(states)
        cosine = np.cos(angle)
        sine = np.sin(angle)
        x, y = offset(states).T / LENGTH_SCALE
        east, north = velocity(states).T
        return np.stack(
            [
                -x * cosine - y * sine,
                x * sine - y * cosine,
                x,
                y,
                np.cos(angle - BAY_HEADING),
                np.sin(angle - BAY_HEADING),
                (east * cosine + north * sine) / 3,
                north * cosine - east * sine,
                layout.part(states, "root.angular_velocity")[:, 2],
                2 * layout.part(states, "steer_fl")[:, 0],
            ],
            axis=1,
        )

    def draw_start(rng: np.random.Generator) -> Float[np.ndarray, " S"]:
        start = np.array(emulator.rest, float)
        noise = rng.uniform(-1, 1, 3) * LANE_NOISE
        position = layout.index("root.position")
        start[position][:2] = LANE_START + noise[:2]
        start[layout.index("root.orientation")] = (
            np.cos(noise[2] / 2),
            0,
            0,
            np.sin(noise[2] / 2),
        )
        return start

    return EpisodeRules(reward, observe, is_over, draw_start, PARKING_STEPS)


def swimmer_rules(emulator: na.Emulator) -> EpisodeRules:
    """Return what Gymnasium's Swimmer-v5 pays, shows and ends, for an emulator that leaps one of its steps."""
    layout = emulator.state
    shown = shown_entries(layout, hidden=("slider1", "slider2"))

    def reward(states: Rows, controls: Rows, following: Rows, dt: float) -> Numbers:
        return forward_velocity(layout, "slider1", states, following, dt) - 1e-4 * squares(controls)

    def observe(states: Rows) -> Rows:
        return states[:, shown]

    return EpisodeRules(reward, observe, draw_start=around(emulator.rest, 0.1), steps=1000)


def hopper_rules(emulator: na.Emulator) -> EpisodeRules:
    """Return what Gymnasium's Hopper-v5 pays, shows and ends, for an emulator that leaps one of its steps."""
    layout = emulator.state
    shown = shown_entries(layout, hidden=("rootx",))
    limits = np.full(layout.size, np.inf)
    for part in layout.slices:
        if part.unit in ("m/s", "rad/s"):
            limits[layout.index(part.name)] = 10.0

    def is_fallen(states: Rows) -> Bool[np.ndarray, " B"]:
        height = layout.part(states, "rootz")[:, 0]
        angle = layout.part(states, "rooty")[:, 0]
        others = np.delete(
            states, [layout.index("rootx").start, layout.index("rootz").start], axis=1
        )
        is_sane = (np.abs(others) < 100).all(axis=1)
        return np.asarray(~((height > 0.7) & (np.abs(angle) < 0.2) & is_sane))

    def reward(states: Rows, controls: Rows, following: Rows, dt: float) -> Numbers:
        forward = forward_velocity(layout, "rootx", states, following, dt)
        return forward - 1e-3 * squares(controls) + ~is_fallen(following)

    def observe(states: Rows) -> Rows:
        return np.clip(states, -limits, limits)[:, shown]

    return EpisodeRules(reward, observe, is_fallen, around(emulator.rest, 0.005), 1000)


def shown_entries(layout: Layout, hidden: tuple[str, ...]) -> list[int]:
    """Return the entries of the state of all parts but the `hidden` ones."""
    left_out = {entry for part in hidden for entry in range(layout.size)[layout.index(part)]}
    return [entry for entry in range(layout.size) if entry not in left_out]


def forward_velocity(
    layout: Layout, part: str, states: Rows, following: Rows, dt: float
) -> Numbers:
    """Return how fast the one number of a part grew over a step."""
    moved = layout.part(following, part)[:, 0].astype(float) - layout.part(states, part)[:, 0]
    return moved / dt


def squares(controls: Rows) -> Numbers:
    """Return the sum of the squared controls of each row."""
    return (np.asarray(controls, float) ** 2).sum(axis=1)


def around(
    rest: Float[np.ndarray, " S"], noise: float
) -> Callable[[np.random.Generator], Float[np.ndarray, " S"]]:
    """Return what draws starts uniformly within ± `noise` of rest."""
    return lambda rng: rest + rng.uniform(-noise, noise, len(rest))


RULES = {"Swimmer-v5": swimmer_rules, "truck": parking_rules, "Hopper-v5": hopper_rules}
"""By the task's name."""
