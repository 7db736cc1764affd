"""Accuracy of slopes (gradients) through contact: an emulator's and the physics', at states of random and of trained policies.

python benchmarks/walking_slopes.py                     Hopper-v5, Walker2d-v5, Ant-v5, human
python benchmarks/walking_slopes.py Hopper-v5 human --keep policies --dry

Each row is of one body, one policy and one horizon: cosines between gradients of the return by all controls within the
horizon, median and minimum over some starts. Gymnasium's bodies are moved by a policy before it learns and after 100 updates,
whose emulator learnt along with it. The human walks and runs by the policy in examples/human, whose emulator was trained
around its motion.

The truth is the gradient of the physics' mean return under noise, estimated from antithetic random controls, each credited
with the rewards that follow it. `halves` is the cosine between two halves of these rollouts, and `exact` the estimate that
follows from it of the cosine between the exact gradient and the truth. An emulator's gradient is taken at the states of the
true rollout (decoupled), or along its own (imagined). Also shown are central differences of the physics without noise and,
where `mujoco-mjx` is installed, MJX's own derivatives (see mjx_slope.py), with the time of one core for compiling them and
for one gradient over the longest horizon. Episodes end where those of the true rollout do.

`--keep` names a folder for the policies, which are read from it if present.

Writes results/walking_slopes.csv.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import mjx_slope
import numpy as np
from commanded import RUNNING, WALKING, Walkers
from following import HUMAN, RESULTS
from jaxtyping import Array, Bool, Float
from walking import prepared

from neuroanimator.cli.policy_returns import loaded_policy
from neuroanimator.control.policies.state_policy import StatePolicy
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.evaluation.csv_table import merge_csv
from neuroanimator.evaluation.machine import describe_machine
from neuroanimator.gym.learner import Learner, PolicyLearning
from neuroanimator.gym.policy_gradient import noisy_controls
from neuroanimator.gym.policy_task import EXPLORATION
from neuroanimator.gym.rules import EpisodeRules
from neuroanimator.systems.rigid.mujoco_system import MujocoSystem
from neuroanimator.terminal import print_table

Rows = list[dict[str, Any]]

Slope = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""(controls (T, C), states (T+1, S) of the true rollout, weights (T,)) → the slope (T, C) of the weighted sum of rewards."""

ENVIRONMENTS = ("Hopper-v5", "Walker2d-v5", "Ant-v5")

BODIES = (*ENVIRONMENTS, "human")

HORIZONS = (0.064, 0.128, 0.25, 0.5, 1.0)
"""Horizons of returns [s], rounded to whole super steps."""

STARTS = 6

ROLLOUTS = 1024
"""Number of pairs of rollouts, with noise and its negative."""

CHUNK = 256
"""Number of pairs of rollouts simulated at once."""

PAID = 4096
"""Maximum number of transitions whose rewards are computed at once: a human's rewards are compiled for each number."""

SPREAD = 0.12
"""Standard deviation of the noise of Gymnasium's bodies, whose controls go from -1 to 1."""

STEP = 1e-3
"""Change of a control for central differences."""

UPDATES = (0, 100)
"""Numbers of updates of a policy after which slopes are measured."""

BANK = 64
"""Number of bodies from whose states starts are drawn."""

AGE = 0.8
"""Simulated time of each of these bodies [s]."""

SETTLING = 100
"""Number of super steps before states of a human's walk are taken."""


class Case(NamedTuple):
    """A body, the policy that moves it, and states of its motion."""

    body: str
    policy_name: str
    system: MujocoSystem
    rules: EpisodeRules
    policy: StatePolicy
    spread: float
    """Standard deviation of the noise on each control, in the control's unit."""
    starts: Float[np.ndarray, "N S"]

    def steps(self, horizon: float) -> int:
        """Return the number of super steps in `horizon` [s]."""
        return max(1, round(horizon / self.policy.dt))


@contextmanager
def folder_at(path: Path | None) -> Iterator[Path]:
    """Yield the folder at `path`, or a temporary one."""
    if path is None:
        with TemporaryDirectory() as place:
            yield Path(place)
        return
    path.mkdir(parents=True, exist_ok=True)
    yield path


def cases_of(body: str, folder: Path, count: int) -> list[Case]:
    """Return the policies of a body (before and after learning, or walking and running), with `count` states each."""
    if body == "human":
        return [human_case("walk", WALKING, count), human_case("run", RUNNING, count)]
    files = {updates: folder / f"{body}.{updates}.policy.safetensors" for updates in UPDATES}
    if not all(file.exists() for file in files.values()):
        learn(body, folder, files)
    cases = []
    for updates, file in files.items():
        policy, system, task = loaded_policy(file, folder / f"{body}.toml")
        assert isinstance(system, MujocoSystem)
        rng = np.random.default_rng(1)
        starts = starts_of(system, task.rules, policy, rng)[:count]
        name = f"{updates} updates"
        cases.append(Case(body, name, system, task.rules, policy, SPREAD, starts))
    return cases


def learn(env_id: str, folder: Path, files: dict[int, Path]) -> None:
    """Write the policy and its emulator after each of the numbers of updates in `files`."""
    system, task, emulator = prepared(env_id, folder, 0)
    learner = Learner(system, emulator, task.rules, PolicyLearning())
    for updates, file in files.items():
        while learner.counters.update < updates:
            learner.advance()
        learner.policy.save(file)


def human_case(name: str, speeds: tuple[float, float], count: int) -> Case:
    """Return the human who goes at `speeds` [m/s]."""
    file = HUMAN / "human.policy.safetensors"
    policy, system, task = loaded_policy(file, HUMAN / "commanded.toml")
    assert isinstance(system, MujocoSystem)
    walkers = Walkers(policy, task, system, count, speeds)
    for _ in range(SETTLING):
        walkers.step()
    return Case("human", name, system, task.rules, policy, EXPLORATION, walkers.states)


def starts_of(
    system: MujocoSystem, rules: EpisodeRules, policy: StatePolicy, rng: np.random.Generator
) -> Float[np.ndarray, "N S"]:
    """Return states of bodies that move under the policy and noise, in random order, none of them fallen."""
    assert rules.draw_start is not None
    states = np.stack([rules.draw_start(rng) for _ in range(BANK)])
    bank = [states]
    for _ in range(round(AGE / policy.dt)):
        noise = jnp.asarray(SPREAD * rng.normal(size=(BANK, system.control.size)), jnp.float32)
        controls = np.asarray(
            noisy_controls(policy, jnp.asarray(states, jnp.float32), noise), float
        )
        runs = system.simulate(states, controls[:, None], policy.dt, scheme=system.scheme)
        states = runs.states[:, 1]
        bank.append(states)
    every = np.concatenate(bank)
    every = every[~np.asarray(rules.is_over(every))]
    return every[rng.permutation(len(every))]


def rolled_out(
    case: Case, start: Float[np.ndarray, " S"], steps: int
) -> tuple[Float[np.ndarray, "T C"], Float[np.ndarray, "T+1 S"]]:
    """Return (controls, states) of the policy without noise on the physics."""
    states = [start]
    controls = []
    calm = jnp.zeros((1, case.system.control.size))
    for _ in range(steps):
        row = jnp.asarray(states[-1][None], jnp.float32)
        control = np.asarray(noisy_controls(case.policy, row, calm), float)
        control = case.policy.emulator.bounds.clip(control)
        controls.append(control[0])
        states.append(simulated(case, states[-1][None], control[None])[0, 1])
    return np.array(controls), np.array(states)


def simulated(
    case: Case,
    starts: Float[np.ndarray, "B S"],
    controls: Float[np.ndarray, "B T C"],
) -> Float[np.ndarray, "B T+1 S"]:
    """Return states on the physics, with the policy's own physics step, on one core."""
    return case.system.simulate(starts, controls, case.policy.dt, scheme=case.system.scheme).states


def paid(
    case: Case, states: Float[np.ndarray, "B T+1 S"], controls: Float[np.ndarray, "B T C"]
) -> Float[np.ndarray, "B T"]:
    """Return the rewards of each step, 0 after the one that ends the episode."""
    shape = controls.shape[:2]
    rewards, is_over = paid_rows(case, *_rows(states, controls))
    return ended(rewards.reshape(shape), is_over.reshape(shape))


def _rows(
    states: Float[np.ndarray, "B T+1 S"], controls: Float[np.ndarray, "B T C"]
) -> tuple[Float[np.ndarray, "N S"], Float[np.ndarray, "N C"], Float[np.ndarray, "N S"]]:
    """Return the transitions (states, controls, states after) of runs one after another."""
    size = states.shape[-1]
    before = states[:, :-1].reshape(-1, size)
    after = states[:, 1:].reshape(-1, size)
    return before, controls.reshape(len(before), -1), after


def paid_rows(
    case: Case,
    before: Float[np.ndarray, "N S"],
    controls: Float[np.ndarray, "N C"],
    after: Float[np.ndarray, "N S"],
) -> tuple[Float[np.ndarray, " N"], Bool[np.ndarray, " N"]]:
    """Return (rewards, whether the episode is over after them) of transitions."""
    count = len(before)
    size = min(count, PAID)
    rewards = np.zeros(count)
    is_over = np.zeros(count, bool)
    for first in range(0, count, size):
        part = np.arange(first, min(first + size, count))
        full = np.resize(part, size)
        found = case.rules.reward(before[full], controls[full], after[full], case.policy.dt)
        rewards[part] = np.asarray(found)[: len(part)]
        is_over[part] = np.asarray(case.rules.is_over(after[full]))[: len(part)]
    return rewards, is_over


def ended(
    rewards: Float[np.ndarray, "B T"], is_over: Bool[np.ndarray, "B T"]
) -> Float[np.ndarray, "B T"]:
    """Return the rewards, 0 after the step that ends an episode."""
    return rewards * (np.cumsum(is_over, axis=1) - is_over == 0)


def goes_on(case: Case, states: Float[np.ndarray, "T+1 S"]) -> Float[np.ndarray, " T"]:
    """Return 1 for each step of an episode, the one that ends it included, and 0 beyond."""
    is_over = np.asarray(case.rules.is_over(states[1:]))
    return (np.cumsum(is_over) - is_over == 0).astype(float)


def measured(case: Case, rollouts: int) -> Rows:
    """Return a row for each horizon; the truth is estimated from `rollouts` pairs of rollouts."""
    rng = np.random.default_rng(2)
    longest = case.steps(max(HORIZONS))
    horizons = list(dict.fromkeys(case.steps(horizon) for horizon in HORIZONS))
    slopes = slopes_of(case)
    names = [*slopes, "differences", "halves", "exact"]
    cosines: dict[str, list[list[float]]] = {name: [[] for _ in horizons] for name in names}
    for start in case.starts:
        controls, states = rolled_out(case, start, longest)
        noise = rng.normal(size=(rollouts, *controls.shape))
        truths = smoothed(case, controls, states[0], horizons, noise)
        moved = differences(case, controls, states)
        for index, (steps, halves) in enumerate(zip(horizons, truths, strict=True)):
            truth = halves.mean(axis=0)
            half = max(cosine(*halves), 0.0)
            found = {"halves": cosine(*halves), "exact": np.sqrt(2 * half / (1 + half))}
            found["differences"] = cosine(summed(moved, steps), truth)
            weights = goes_on(case, states) * (np.arange(longest) < steps)
            for name, slope in slopes.items():
                found[name] = cosine(slope(controls, states, weights)[:steps], truth)
            for name, value in found.items():
                cosines[name][index].append(float(value))
    rows: Rows = []
    for index, steps in enumerate(horizons):
        row: dict[str, Any] = {
            "body": case.body,
            "policy": case.policy_name,
            "horizon_s": steps * case.policy.dt,
            "steps": steps,
            "starts": len(case.starts),
            "rollouts": rollouts,
        }
        for name in names:
            row[name] = float(np.median(cosines[name][index]))
            row[f"{name}_least"] = float(np.min(cosines[name][index]))
        physics = slopes.get("mjx")
        if isinstance(physics, PhysicsSlope):
            row["mjx_compile_s"] = physics.leap.compile_seconds
            row["mjx_gradient_s"] = physics.leap.seconds * steps
        rows.append(row)
    return rows


def slopes_of(case: Case) -> dict[str, Slope]:
    """Return the functions that compute slopes by derivatives, by name."""
    slopes: dict[str, Slope] = {
        "decoupled": emulator_slope(case, is_true=True),
        "imagined": emulator_slope(case, is_true=False),
    }
    if mjx_slope.is_installed() and case.body in ENVIRONMENTS:
        slopes["mjx"] = PhysicsSlope(case)
    return slopes


def emulator_slope(case: Case, *, is_true: bool) -> Slope:
    """Return a function for the emulator's slopes, at the true states or along its own."""
    emulator = case.policy.emulator

    def slope(controls: np.ndarray, states: np.ndarray, weights: np.ndarray) -> np.ndarray:
        if not is_true:
            states = emulator.rollout(states[0], controls)
        way = jnp.asarray(states, jnp.float32)
        driven = jnp.asarray(controls, jnp.float32)
        rewards = _reward_slopes(
            case.rules.reward, way, driven, jnp.asarray(weights, jnp.float32), emulator.dt
        )
        return np.asarray(_return_slope(emulator, way, driven, rewards), float)

    return slope


class RewardSlopes(NamedTuple):
    """Derivatives of the weighted sum of rewards, step by step."""

    before: Float[Array, "T S"]
    """By the state before the step."""
    controls: Float[Array, "T C"]
    after: Float[Array, "T S"]


@eqx.filter_jit
def _reward_slopes(
    reward: Any,
    states: Float[Array, "T+1 S"],
    controls: Float[Array, "T C"],
    weights: Float[Array, " T"],
    dt: float,
) -> RewardSlopes:
    def total(before: Array, controls: Array, after: Array) -> Float[Array, ""]:
        return (weights * reward(before, controls, after, dt)).sum()

    slopes = jax.grad(total, argnums=(0, 1, 2))(states[:-1], controls, states[1:])
    return RewardSlopes(*slopes)


@eqx.filter_jit
def _return_slope(
    emulator: Emulator,
    states: Float[Array, "T+1 S"],
    controls: Float[Array, "T C"],
    rewards: RewardSlopes,
) -> Float[Array, "T C"]:
    """Return the slope of the return by the controls: rewards' slopes, propagated back through the emulator at `states`."""

    def back(later: Float[Array, " S"], moment: tuple) -> tuple[Array, Array]:
        state, control, of_reward = moment
        _, pull = jax.vjp(emulator.step, state, control)
        by_state, by_control = pull(of_reward.after + later)
        return of_reward.before + by_state, of_reward.controls + by_control

    moments = (states[:-1], controls, rewards)
    _, slopes = jax.lax.scan(back, jnp.zeros(states.shape[1]), moments, reverse=True)
    return slopes


class PhysicsSlope:
    """MJX's slopes, along its own rollouts, up to the last step that has a weight.

    The super steps of the last rollout are kept: returns over several horizons need the same.
    """

    def __init__(self, case: Case):
        model = case.system.model_with(case.system.scheme)
        self.case = case
        self.leap = mjx_slope.Linearised(model, case.system.scheme.steps(case.policy.dt))
        self._controls = np.empty(0)
        self._leaps: list[mjx_slope.Leap] = []

    def __call__(self, controls: np.ndarray, states: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return the slope (T, C) by the controls (T, C), from the first of the states (T+1, S)."""
        steps = int(np.flatnonzero(weights)[-1]) + 1
        leaps = self._rolled_out(controls, states[0], steps)
        way = np.stack([states[0], *(leap.after for leap in leaps)])
        rewards = _reward_slopes(
            self.case.rules.reward, way, controls[:steps], weights[:steps], self.case.policy.dt
        )
        before, direct, after = (np.asarray(part, float) for part in rewards)
        slopes = np.zeros(controls.shape)
        later = np.zeros(states.shape[1])
        for step in reversed(range(steps)):
            later = later + after[step]
            slopes[step] = direct[step] + later @ leaps[step].by_control
            later = before[step] + later @ leaps[step].by_state
        return slopes

    def _rolled_out(
        self, controls: np.ndarray, start: np.ndarray, steps: int
    ) -> list[mjx_slope.Leap]:
        """Return the first `steps` super steps."""
        if self._controls is not controls:
            self._controls = controls
            self._leaps = []
        while len(self._leaps) < steps:
            at = self._leaps[-1].after if self._leaps else start
            self._leaps.append(self.leap(at, controls[len(self._leaps)]))
        return self._leaps[:steps]


def smoothed(
    case: Case,
    controls: Float[np.ndarray, "T C"],
    start: Float[np.ndarray, " S"],
    horizons: list[int],
    noise: Float[np.ndarray, "N T C"],
) -> list[Float[np.ndarray, "2 H C"]]:
    """Return, per horizon of H super steps, two estimates of the slope of the mean return under noise."""
    bounds = case.policy.emulator.bounds
    parts = []
    for first in range(0, len(noise), CHUNK):
        changes = case.spread * noise[first : first + CHUNK]
        shaken = bounds.clip(np.concatenate([controls + changes, controls - changes]))
        starts = np.repeat(start[None], len(shaken), axis=0)
        more, less = np.split(paid(case, simulated(case, starts, shaken), shaken), 2)
        parts.append(more - less)
    gained = np.concatenate(parts)
    found = []
    for steps in horizons:
        # A control does not affect the rewards before it.
        from_then_on = np.cumsum(gained[:, :steps][:, ::-1], axis=1)[:, ::-1]
        terms = from_then_on[..., None] * noise[:, :steps]
        found.append(terms.reshape(2, -1, *terms.shape[1:]).mean(axis=1))
    return found


def differences(
    case: Case, controls: Float[np.ndarray, "T C"], states: Float[np.ndarray, "T+1 S"]
) -> Float[np.ndarray, "T C T"]:
    """Return central differences of the reward of every step by each control, each from the true state before it."""
    steps, size = controls.shape
    bounds = case.policy.emulator.bounds
    transitions = []
    for step in range(steps):
        rest = controls[step:]
        changes = np.zeros((size, *rest.shape))
        changes[:, 0] = STEP * np.eye(size)
        moved = bounds.clip(np.concatenate([rest + changes, rest - changes]))
        starts = np.repeat(states[step : step + 1], len(moved), axis=0)
        transitions.append(_rows(simulated(case, starts, moved), moved))
    rewards, is_over = paid_rows(
        case, *(np.concatenate(part) for part in zip(*transitions, strict=True))
    )
    found = np.zeros((steps, size, steps))
    is_on = goes_on(case, states)
    first = 0
    for step in range(steps):
        shape = (2 * size, steps - step)
        part = slice(first, first + shape[0] * shape[1])
        more, less = np.split(ended(rewards[part].reshape(shape), is_over[part].reshape(shape)), 2)
        found[step, :, step:] = is_on[step] * (more - less) / (2 * STEP)
        first = part.stop
    return found


def summed(moved: Float[np.ndarray, "T C T"], steps: int) -> Float[np.ndarray, "H C"]:
    """Return the slope of the return over `steps` from differences of the rewards."""
    return moved[:steps, :, :steps].sum(axis=-1)


def difference_slope(case: Case) -> Slope:
    """Return a function for central differences of the return on the physics, whose episodes end on their own."""

    def slope(controls: np.ndarray, states: np.ndarray, weights: np.ndarray) -> np.ndarray:
        return summed(differences(case, controls, states), len(controls))

    return slope


def cosine(one: np.ndarray, other: np.ndarray) -> float:
    return float((one * other).sum() / (np.linalg.norm(one) * np.linalg.norm(other) + 1e-30))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("bodies", nargs="*", default=list(BODIES))
    parser.add_argument("--keep", type=Path, help="folder for the learnt policies")
    parser.add_argument("--starts", type=int, default=STARTS)
    parser.add_argument("--rollouts", type=int, default=ROLLOUTS)
    parser.add_argument("--dry", action="store_true", help="write no file")
    arguments = parser.parse_args()
    print(describe_machine())
    file = RESULTS / "walking_slopes.csv"
    for body in arguments.bodies:
        with folder_at(arguments.keep) as folder:
            for case in cases_of(body, folder, arguments.starts):
                rows = measured(case, arguments.rollouts)
                print_table(rows)
                if not arguments.dry:
                    merge_csv(file, rows, "body", "policy")


if __name__ == "__main__":
    main()
