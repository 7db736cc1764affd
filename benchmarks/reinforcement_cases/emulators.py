"""Emulators of the tasks: by defaults but for their size, then rounds in which policies learnt inside act on MuJoCo."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode

import neuroanimator as na
from neuroanimator import control
from neuroanimator.data.config import RUN_STEPS, USUAL_SAMPLES_PER_RUN
from neuroanimator.gym import EmulatorVectorEnv, PhysicsVectorEnv
from neuroanimator.scaffold.write_toml import write_definition
from neuroanimator.systems.loading import resolve
from neuroanimator.terminal import phase, progress_bar
from reinforcement_cases.learning import Point, learn, rows_world
from reinforcement_cases.policies import PlainPolicy, play
from reinforcement_cases.tasks import LearningTask, Recipe

FIRST_ROUND_SEED = 100
"""Of the policies of rounds; those that count have others."""

PLAYED = 16
"""Episodes on MuJoCo of each policy of a round that is looked at: half of them by its mean actions, half as it learns."""

PLAYED_STEPS = 250
"""Maximum number of first steps taken of an episode."""

PLAYED_POLICIES = 4
"""Number of policies looked at of a round, from its beginning to its end."""


class Made(NamedTuple):
    """An emulator, and what it took."""

    emulator: na.Emulator
    seconds: float
    """Processor time of all that made it: proposal, simulation, training, rounds. NaN for one that ships."""
    environment_steps: int
    """Steps of MuJoCo it was learnt from."""


def emulator_for(task: LearningTask, workplace: Path) -> Made:
    """Return the emulator of a task; it is made if it is not in `workplace`."""
    if task.recipe is None:
        return Made(na.load_emulator(task.emulator), float("nan"), 0)
    folder = workplace / task.name
    path = folder / f"round-{task.recipe.rounds}.emulator.safetensors"
    notes = folder / "made.json"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        make_rounds(task, task.recipe, folder, notes)
    told = json.loads(notes.read_text())
    return Made(na.load_emulator(path), sum(told["seconds"].values()), told["environment_steps"])


def first_emulator(task: LearningTask, workplace: Path) -> na.Emulator | None:
    """Return a task's emulator as it was before any round; None for one that ships."""
    if task.recipe is None:
        return None
    return na.load_emulator(workplace / task.name / "round-0.emulator.safetensors")


def make_rounds(task: LearningTask, recipe: Recipe, folder: Path, notes: Path) -> None:
    """Make a task's emulators, one a round, and note what each took; those that are there are kept."""
    first = folder / "round-0.emulator.safetensors"
    runs = -(-recipe.transitions // USUAL_SAMPLES_PER_RUN)
    told = {"seconds": {}, "environment_steps": runs * RUN_STEPS}
    if notes.exists():
        told = json.loads(notes.read_text())

    def note(what: str, begun: float) -> None:
        told["seconds"][what] = time.process_time() - begun
        notes.write_text(json.dumps(told, indent=2))

    if not first.exists():
        begun = time.process_time()
        learn_by_default(task.name, recipe, folder, first)
        note("round 0", begun)
    data = na.read_transitions(folder / "data")
    seen: list[control.Episode] = []
    for number in range(1, recipe.rounds + 1):
        begun = time.process_time()
        path = folder / f"round-{number}.emulator.safetensors"
        kept = folder / f"round-{number}.npz"
        if not kept.exists():
            emulator = na.load_emulator(folder / f"round-{number - 1}.emulator.safetensors")
            keep_episodes(kept, episodes_of_round(task, recipe, emulator, number))
        episodes = kept_episodes(kept)
        seen += episodes
        if path.exists():
            continue
        emulator = na.load_emulator(folder / f"round-{number - 1}.emulator.safetensors")
        with phase(f"{task.name}: round {number}: learning what {len(seen)} episodes saw"):
            control.learn_from(emulator, seen, data, updates=recipe.refining).save(path)
        told["environment_steps"] += sum(episode.environment_steps for episode in episodes)
        note(f"round {number}", begun)


def keep_episodes(path: Path, episodes: list[control.Episode]) -> None:
    """Write what episodes saw into a file."""
    arrays = {f"controls_{row}": episode.controls for row, episode in enumerate(episodes)}
    arrays |= {f"states_{row}": episode.states for row, episode in enumerate(episodes)}
    np.savez_compressed(path, allow_pickle=False, **arrays)


def kept_episodes(path: Path) -> list[control.Episode]:
    """Return the episodes of such a file."""
    arrays = np.load(path)
    count = len(arrays.files) // 2
    return [episode_of(arrays[f"states_{row}"], arrays[f"controls_{row}"]) for row in range(count)]


def episode_of(states: np.ndarray, controls: np.ndarray) -> control.Episode:
    """Return an episode of whole steps."""
    steps = len(controls)
    return control.Episode(controls, states, np.zeros(steps), np.zeros(1), False, steps, steps)


def learn_by_default(name: str, recipe: Recipe, folder: Path, path: Path) -> None:
    """Make an emulator by `new`, `generate` and `train` as they are, but for its size and super step."""
    toml = folder / f"{name.split('-')[0].lower()}.toml"
    if not toml.exists():
        write_definition(name, toml)
    system, definition, _ = resolve(str(toml))
    config = na.DatasetConfig.usual(system, definition, recipe.substeps, count=recipe.transitions)
    with progress_bar(f"{name}: simulating", config.shards) as bar:
        done = iter(range(1, config.shards + 1))
        na.generate(config, folder / "data", on_shard=lambda: bar.advance_to(next(done)))
    data = na.read_transitions(folder / "data")
    usual = na.TrainingConfig.usual(data.system.structure)
    chosen = usual.model_dump() | {"widths": recipe.widths, "updates": recipe.updates}
    training = na.TrainingConfig(**chosen)
    with progress_bar(f"{name}: training", training.updates) as bar:
        na.train(data, training, path, on_report=lambda report: bar.advance_to(report.update))


def episodes_of_round(
    task: LearningTask, recipe: Recipe, emulator: na.Emulator, number: int
) -> list[control.Episode]:
    """Return what policies did on MuJoCo that a learner inside had, from its first to its last."""
    rules = task.rules(emulator)
    seed = FIRST_ROUND_SEED + number - 1
    noisy = np.arange(PLAYED) % 2 == 1
    physics = PhysicsVectorEnv(emulator, PLAYED, seconds=PLAYED_STEPS * emulator.dt, rules=rules)
    seen: list[control.Episode] = []

    def judge(policy: PlainPolicy) -> tuple[float, float]:
        played = play(policy, physics, seed, noisy)
        for row in range(PLAYED):
            steps = int(played.lengths[row])
            states = played.states[: steps + 1, row]
            controls = played.controls[:steps, row]
            seen.append(episode_of(states, controls))
        return float("nan"), float(played.returns[~noisy].mean())

    with progress_bar(f"{task.name}: round {number}", round(recipe.round_seconds)) as bar:

        def tell(point: Point) -> None:
            said = f"on MuJoCo {point.mujoco_return:.3g} in {PLAYED_STEPS} steps"
            bar.advance_to(min(round(point.seconds), round(recipe.round_seconds)), said)

        world = rows_world(guarded(task, emulator, task.learning.rows))
        learn(
            world,
            task.learning,
            seed,
            judge,
            np.inf,
            recipe.round_seconds,
            tell,
            time.process_time,
            PLAYED_POLICIES,
        )
    return seen


def guarded(task: LearningTask, emulator: na.Emulator, rows: int) -> EmulatorVectorEnv:
    """Return the inside of an emulator, kept where it is to be trusted."""
    return EmulatorVectorEnv(
        emulator,
        rows,
        rules=task.rules(emulator),
        trust_limit=task.trust_limit,
        trust_penalty=task.trust_penalty,
        autoreset_mode=AutoresetMode.SAME_STEP,
    )
