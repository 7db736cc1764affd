"""A human who is pushed over gets up and walks on: how often.

python -m benchmarks.following.getting_up
python -m benchmarks.following.getting_up --get-up other.policy.safetensors --dry
python -m benchmarks.following.getting_up --falls examples/human/falls.safetensors

100 bodies walk at 0.9 m/s on the physics, by examples/human/human.policy.safetensors, and are pushed over by 150 N s on the
trunk, a force over 0.1 s in a random horizontal direction. Once a trunk is 0.9 rad off the vertical, its servos take the
pose in which get-up.csv begins; a body that does not lie on its front rolls over by two more poses.
After that examples/human/get-up.policy.safetensors follows its motion, seen from where the body lies, until it stands, and the
walking policy takes over, at 0 m/s for a second and at 0.9 m/s for ten. A body has got up if its trunk is then within 0.5 rad of
the vertical, and walks on if it never tilts by more than 0.9 rad afterwards.

Writes getting_up.csv; with --falls instead four falls, ahead, to the left, back and to the right, each until the
body stands again: the studio shows the one that fits when somebody has pushed its human over.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from safetensors.numpy import save_file

from benchmarks.following.commanded import Walkers, controls_of
from benchmarks.harness import HUMAN, keep_rows, parser_of, show_rows
from neuroanimator.cli.policy_returns import loaded_policy
from neuroanimator.control.policies.reference_motion import ORIENTATION, POSITION, TURN
from neuroanimator.control.policies.state_policy import StatePolicy, load_state_policy
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem
from neuroanimator.state.rotation import facing, heading_of, multiply, rotate

BODIES = 100

PUSHES = 1
"""Seed of the pushes' directions; the roll was found for those of seed 0."""

SPEED = 0.9
"""Commanded speed [m/s]."""

WALK_SECONDS = 3.0
"""Time of walking before the push [s]."""

IMPULSE = 150.0
"""Impulse of the push [N s]: it changes the speed of the whole body by 2.2 m/s."""

UPRIGHT = 0.5
"""Angle of the trunk to the vertical below which a body that got up stands [rad]."""

FALLING_TILT = 0.9
"""Angle of the trunk to the vertical from which a body is taken to fall [rad]."""

FALL_SECONDS = 4.0
"""Time from the push until those who fall lie still [s]."""

YIELDING = 0.5
"""Time in which servos go over from one pose to another [s]."""

ROLL = (
    {
        "abdomen_y": -0.8,
        "hip_x_right": 0.2,
        "hip_y_right": 0.2,
        "hip_x_left": -0.1,
        "hip_y_left": 0.5,
        "shoulder_x_right": 0.3,
        "elbow_right": 0.2,
    },
    {"hip_z_right": 0.2, "hip_y_right": 0.4, "elbow_right": -0.1},
)
"""Two poses that roll a body over, as differences from the lying pose [rad]: found by cross-entropy search on the physics, 28
generations of 72, over bodies that lay on their backs, and rounded."""

ROLLS = 2
"""Maximum number of times that a body rolls over: after the first, some lie on their side."""

ON_FRONT = -0.5
"""Height of the chest's normal below which a body lies on its front."""

ROLL_SECONDS = 0.6
"""Time of each of the two [s]."""

SETTLE_SECONDS = 1.5
"""Time from the last of them until the body lies still [s]."""

PAUSE = 1.0
"""Time of standing before it walks on [s]."""

AFTER_SECONDS = 10.0
"""Time from the end of getting up in which it may not fall again [s]."""

FALLS = np.array([0.0, np.pi / 2, np.pi, -np.pi / 2])
"""Directions of the falls of --falls, from straight ahead to the left [rad]."""

EVERY = 2
"""Super steps from one kept state of a fall to the next."""

STILL = 0.3
"""Root mean square of the velocities below which a body lies still [rad/s]."""

MAX_STILL = 10
"""Number of kept states of lying still; more are left out."""


class Fallers:
    """Bodies that walk, and after a fall lie still, roll over or get up; those that have not fallen walk all along."""

    def __init__(self, walkers: Walkers, get_up: StatePolicy):
        motion = get_up.view.reference
        commands = walkers.reference.commands
        assert motion is not None
        assert commands is not None
        self.walkers = walkers
        self.get_up = get_up
        self.motion = motion
        self.dt = walkers.policy.dt
        self.unseen = [commands.heading, commands.turning]
        """State entries that the body of the motion lacks."""
        self.has_fallen = np.zeros(len(walkers.states), bool)
        self.targets = walkers.controls()
        """Last controls (N, C)."""
        self.states = [walkers.states]
        """States (N, S), a super step apart."""

    def walk(self, seconds: float, speed: float) -> None:
        """Walk at a commanded speed [m/s]; a body that tilts too far has fallen, and its servos take the lying pose."""
        self.walkers.told[:] = [speed, 0.0]
        since = np.full(len(self.has_fallen), np.inf)
        before = self.targets
        for step in range(round(seconds / self.dt)):
            falls = ~self.has_fallen & (self.tilts() > FALLING_TILT)
            before = np.where(falls[:, None], self.targets, before)
            since[falls] = step
            self.has_fallen |= falls
            share = np.clip((step - since) * self.dt / YIELDING, 0, 1)[:, None]
            self._step((1 - share) * before + share * self.pose({}))

    def take_pose(
        self, offsets: dict[str, float], seconds: float, is_asked: Bool[np.ndarray, " N"]
    ) -> None:
        """Let servos go over to the lying pose, with `offsets` [rad] for the bodies that are asked to."""
        asked = np.where(is_asked[:, None], self.pose(offsets), self.pose({}))
        before = self.targets
        for step in range(round(seconds / self.dt)):
            share = min(1.0, (step + 1) * self.dt / YIELDING)
            self._step((1 - share) * before + share * asked)

    def rise(self) -> None:
        """Let bodies that have fallen follow the motion once, from where they lie."""
        first = np.asarray(self.motion.frames[0], float)
        states = self.walkers.states
        origin = states[:, POSITION]
        turn = heading_of(states[:, ORIENTATION]) - heading_of(first[ORIENTATION])
        for step in range(self.motion.lap + 1):
            seen = _moved(self.walkers.states, origin, turn, self.walkers.reference.velocity)
            seen[:, :2] += first[:2]
            seen = np.delete(seen, self.unseen, axis=1)
            seen[:, self.motion.phase] = TURN * step / self.motion.lap
            seen[:, -1] = first[-1]
            self._step(controls_of(self.get_up, seen))

    def stand_up(self) -> None:
        """Hand all bodies that are upright to the walking policy, headed as they are."""
        walkers = self.walkers
        is_upright = self.tilts() < UPRIGHT
        headings = heading_of(walkers.states[:, ORIENTATION])
        rising = self.has_fallen & is_upright
        walkers.states[rising, self.unseen[0]] = headings[rising]
        self.has_fallen &= ~is_upright

    def pose(self, offsets: dict[str, float]) -> Float[np.ndarray, " C"]:
        """Return the servos' targets for the lying pose, with `offsets` of joints [rad]."""
        targets = np.asarray(self.motion.frames[0], float)[list(self.motion.driven)]
        for name, offset in offsets.items():
            targets[self.walkers.system.model.actuator(name).id] += offset
        return targets

    def tilts(self) -> Float[np.ndarray, " N"]:
        """Return the angles of trunks to the vertical [rad]."""
        return np.arccos(np.clip(self.walkers.trunks(self.walkers.states)[:, 2, 2], -1, 1))

    def lie_otherwise(self) -> Bool[np.ndarray, " N"]:
        """Return whether each body has fallen and does not lie on its front."""
        return self.has_fallen & (self.walkers.trunks(self.walkers.states)[:, 2, 0] > ON_FRONT)

    def _step(self, lying: Float[np.ndarray, "N C"]) -> None:
        """Take one super step, with these controls for the bodies that have fallen."""
        walkers = self.walkers
        walkers.states = np.array(walkers.reference.with_command(walkers.states, walkers.told))
        self.targets = np.where(self.has_fallen[:, None], lying, walkers.controls())
        everyone = np.ones(len(self.targets), bool)
        walkers.states = walkers.stepper(walkers.states, self.targets, everyone).states
        self.states.append(walkers.states)


def _moved(
    states: Float[np.ndarray, "N S"],
    origin: Float[np.ndarray, "N 3"],
    turn: Float[np.ndarray, " N"],
    velocity: int,
) -> Float[np.ndarray, "N S"]:
    """Return the states as seen from points on the floor below `origin` [m], turned by `turn` about the vertical [rad]."""
    states = states.copy()
    back = facing(-turn)
    off = states[:, POSITION] - origin
    states[:, :2] = rotate(back, off)[:, :2]
    states[:, ORIENTATION] = multiply(back, states[:, ORIENTATION])
    linear = slice(velocity, velocity + 3)
    states[:, linear] = rotate(back, states[:, linear])
    return states


def fallen_and_risen(
    get_up: Path, angles: Float[np.ndarray, " N"]
) -> tuple[Fallers, dict[str, Any]]:
    """Return (bodies after all of it, their counts), one for each angle of a push from straight ahead to the left [rad]."""
    policy, system, task = loaded_policy(
        HUMAN / "human.policy.safetensors", HUMAN / "commanded.toml"
    )
    assert isinstance(system, MujocoSystem)
    walkers = Walkers(policy, task, system, len(angles), (SPEED, SPEED))
    fallers = Fallers(walkers, load_state_policy(get_up))
    fallers.walk(WALK_SECONDS, SPEED)
    headings = heading_of(walkers.states[:, ORIENTATION])
    for row, angle in enumerate(headings + angles):
        walkers.push(row, IMPULSE, angle)
    fallers.walk(FALL_SECONDS, SPEED)
    fell = fallers.has_fallen.copy()
    on_back = fallers.lie_otherwise()
    for _ in range(ROLLS):
        rolls = fallers.lie_otherwise()
        if not rolls.any():
            break
        for offsets in ROLL:
            fallers.take_pose(offsets, ROLL_SECONDS, rolls)
        fallers.take_pose({}, SETTLE_SECONDS, rolls)
    on_front = fell & ~fallers.lie_otherwise()
    fallers.rise()
    fallers.stand_up()
    stands = fell & ~fallers.has_fallen
    fallers.walk(PAUSE, 0.0)
    fallers.walk(AFTER_SECONDS, SPEED)
    row = {
        "pushed": len(angles),
        "fell": int(fell.sum()),
        "on their backs": int(on_back.sum()),
        "on their fronts in the end": int(on_front.sum()),
        "got up": int(stands.sum()),
        "walked on for 10 s": int((stands & ~fallers.has_fallen).sum()),
    }
    return fallers, row


def write_falls(get_up: Path, out: Path) -> None:
    """Write the states (T, S) of a body from each push until it stands again, by number."""
    fallers, _ = fallen_and_risen(get_up, FALLS)
    dt = fallers.dt
    first = round(WALK_SECONDS / dt) + 1
    last = len(fallers.states) - round(AFTER_SECONDS / dt)
    states = np.array(fallers.states[first:last:EVERY], np.float32)
    # The last two are the clock and the commanded heading.
    velocities = states[..., fallers.walkers.reference.velocity : -2]
    falls = {}
    for number in range(len(FALLS)):
        kept = []
        still = 0
        for state, velocity in zip(states[:, number], velocities[:, number], strict=True):
            still = still + 1 if np.sqrt(np.mean(velocity**2)) < STILL else 0
            if still <= MAX_STILL:
                kept.append(state)
        falls[str(number)] = np.stack(kept)
    save_file(falls, out)


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--get-up", type=Path, default=HUMAN / "get-up.policy.safetensors")
    parser.add_argument("--falls", type=Path, help="write four falls to this file")
    arguments = parser.parse_args()
    if arguments.falls:
        write_falls(arguments.get_up, arguments.falls)
        return
    angles = np.random.default_rng(PUSHES).uniform(-np.pi, np.pi, BODIES)
    _, row = fallen_and_risen(arguments.get_up, angles)
    show_rows([row])
    keep_rows(Path(__file__).with_name("getting_up.csv"), [row], arguments)


if __name__ == "__main__":
    main()
