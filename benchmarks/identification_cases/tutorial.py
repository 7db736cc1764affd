"""The three cases of the tutorial of MuJoCo's system identification: a spring, an arm, a cart.

Bodies, motions, noise, bounds and first guesses are those of google-deepmind/mujoco, python/mujoco/sysid/sysid.ipynb
(Apache-2.0). A model's own parameters are the first guesses, so that `na.identify` begins with them, too.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float
from mujoco import rollout, sysid

import neuroanimator as na
from identification_cases.emulators import Case, Made, made
from identification_cases.toolbox import run_toolbox
from neuroanimator import NeuroAnimatorError
from neuroanimator.evaluation.held_out import system_of
from neuroanimator.scaffold.write_toml import write_definition
from neuroanimator.systems.recorded.columns import column_names

STEP = 0.002
"""Physics step of all models, and time between samples of all recordings [s]."""

SUBSTEPS = 10
"""Number of physics steps in an emulator's super step: the proposed 0.1 s is too long for controls of several hertz."""

TRANSITIONS = 100_000
"""A third of the usual number: so small systems need no more."""

DIFFERENCE = 1e-6
"""Change of a parameter by which the toolbox's intervals are measured: within its accuracy, as its own differences are."""

LIMIT = 120.0
"""Time that the toolbox gets [s]."""

SPRING = """
<mujoco model="spring">
  <option timestep="0.002"><flag contact="disable"/></option>
  <worldbody>
    <body name="mass">
      <inertial pos="0 0 0" mass="2" diaginertia="0.001 0.001 0.001"/>
      <joint name="spring" type="slide" axis="1 0 0" stiffness="100" damping="5"/>
      <geom type="sphere" size="0.05"/>
    </body>
  </worldbody>
  <actuator><motor name="force" joint="spring" ctrlrange="-9 9"/></actuator>
  <sensor><jointpos name="spring position" joint="spring"/><jointvel name="spring velocity" joint="spring"/></sensor>
</mujoco>
"""

ARM = """
<mujoco model="arm">
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="implicitfast"><flag contact="disable"/></option>
  <default><joint range="-3.14 3.14" armature="0.01"/></default>
  <worldbody>
    <body name="link1" pos="0 0 0.1">
      <inertial pos="0 0 0.05" mass="1" diaginertia="0.01 0.01 0.005"/>
      <joint name="joint1" axis="0 0 1" damping="1"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.1" size="0.04"/>
      <body name="link2" pos="0 0 0.1">
        <inertial pos="0 0 0.05" mass="0.8" diaginertia="0.008 0.008 0.004"/>
        <joint name="joint2" axis="0 1 0" damping="0.8"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.1" size="0.035"/>
        <body name="link3" pos="0 0 0.1">
          <inertial pos="0 0 0.05" mass="0.6" diaginertia="0.006 0.006 0.003"/>
          <joint name="joint3" axis="0 1 0" damping="0.6"/>
          <geom type="capsule" fromto="0 0 0 0 0 0.1" size="0.03"/>
          <body name="link4" pos="0 0 0.1">
            <inertial pos="0 0 0.04" mass="0.4" diaginertia="0.004 0.004 0.002"/>
            <joint name="joint4" axis="0 0 1" damping="0.4"/>
            <geom type="capsule" fromto="0 0 0 0 0 0.08" size="0.025"/>
            <body name="link5" pos="0 0 0.08">
              <inertial pos="0 0 0.03" mass="0.2" diaginertia="0.002 0.002 0.001"/>
              <joint name="joint5" axis="0 1 0" damping="0.2"/>
              <geom type="capsule" fromto="0 0 0 0 0 0.06" size="0.02"/>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="motor1" joint="joint1" ctrlrange="-6 6"/>
    <motor name="motor2" joint="joint2" ctrlrange="-5 5"/>
    <motor name="motor3" joint="joint3" ctrlrange="-4 4"/>
    <motor name="motor4" joint="joint4" ctrlrange="-3 3"/>
    <motor name="motor5" joint="joint5" ctrlrange="-1.5 1.5"/>
  </actuator>
  <sensor>
    <jointpos name="joint1 position" joint="joint1"/>
    <jointpos name="joint2 position" joint="joint2"/>
    <jointpos name="joint3 position" joint="joint3"/>
    <jointpos name="joint4 position" joint="joint4"/>
    <jointpos name="joint5 position" joint="joint5"/>
  </sensor>
</mujoco>
"""

CART = """
<mujoco model="cart">
  <option timestep="0.002"><flag contact="disable"/></option>
  <worldbody>
    <body name="cart">
      <inertial pos="0 0 0" mass="3.5" diaginertia="0.001 0.001 0.001"/>
      <joint name="rail" type="slide" axis="1 0 0"/>
      <geom type="sphere" size="0.05"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="rail" gear="5.25" ctrlrange="-6 6"/></actuator>
  <sensor><jointpos name="rail position" joint="rail"/><jointvel name="rail velocity" joint="rail"/></sensor>
</mujoco>
"""


class Unknown(NamedTuple):
    """A parameter to be found."""

    name: str
    sets: str
    """What it sets: element/name/attribute."""
    low: float
    high: float
    first: float
    """The first guess, which is the model's own value."""
    true: float


class Wave(NamedTuple):
    """A part of a control: amplitude · sin(2π · hertz · t + phase)."""

    amplitude: float
    hertz: float
    phase: float = 0.0


class Lesson(NamedTuple):
    """A case of the tutorial."""

    name: str
    model: str
    """Its MJCF; its sensors are what is recorded."""
    unknowns: tuple[Unknown, ...]
    waves: tuple[tuple[Wave, ...], ...]
    """The parts of each control."""
    seconds: float
    updates: int
    """Updates of the emulator's training: half of the usual number, and a tenth where they are slow."""
    noise: float = 0.0
    """Standard deviation of the noise in each sensor."""


ARMATURES = tuple(
    Unknown(f"armature{i}", f"joint/joint{i}/armature", 0.01, 0.6, 0.01, 0.6 - 0.1 * i)
    for i in range(1, 6)
)

TORQUES = (
    (Wave(5, 0.5),),
    (Wave(4, 0.7, 0.5),),
    (Wave(3, 0.4, 1.0),),
    (Wave(2, 0.9, 1.5),),
    (Wave(1, 0.6, 2.0),),
)

NOISY_ARM = Lesson("arm", ARM, ARMATURES, TORQUES, seconds=2.0, updates=4_000, noise=0.6)

LESSONS = (
    Lesson(
        "spring",
        SPRING,
        (Unknown("mass", "body/mass/mass", 0.3, 3.0, 2.0, 1.0),),
        ((Wave(5, 1.5), Wave(3, 3.7)),),
        seconds=3.0,
        updates=20_000,
    ),
    NOISY_ARM,
    NOISY_ARM._replace(noise=0.006),
    Lesson(
        "cart",
        CART,
        (
            Unknown("mass", "body/cart/mass", 0.5, 5.0, 3.5, 2.0),
            Unknown("gear", "actuator/motor/gear", 0.5, 8.0, 5.25, 3.0),
        ),
        ((Wave(3, 2.0), Wave(2, 5.0)),),
        seconds=0.6,
        updates=20_000,
    ),
)
"""The cases of the tutorial, and its arm with a hundredth of the noise."""


def set_parameters(spec: mujoco.MjSpec, lesson: Lesson, values: Float[np.ndarray, " P"]) -> None:
    """Set the unknowns of a model."""
    for unknown, value in zip(lesson.unknowns, values, strict=True):
        element, name, attribute = unknown.sets.split("/")
        if attribute == "gear":
            spec.actuator(name).gear[0] = value
        elif element == "body":
            spec.body(name).mass = value
        else:
            spec.joint(name).armature = value


class Recorded(NamedTuple):
    """The tutorial's recording: sensors at the start of each of K physics steps, from rest."""

    measured: Float[np.ndarray, "K M"]
    controls: Float[np.ndarray, "K+1 C"]


def record_lesson(lesson: Lesson) -> Recorded:
    """Return the recording of the true body, by the model's own integrator."""
    spec = mujoco.MjSpec.from_string(lesson.model)
    set_parameters(spec, lesson, np.array([unknown.true for unknown in lesson.unknowns]))
    model = spec.compile()
    data = mujoco.MjData(model)
    times = STEP * np.arange(int(lesson.seconds / STEP))
    controls = np.zeros((len(times), model.nu))
    for column, waves in enumerate(lesson.waves):
        for wave in waves:
            phases = 2 * np.pi * wave.hertz * times + wave.phase
            controls[:, column] += wave.amplitude * np.sin(phases)
    start = sysid.create_initial_state(model, data.qpos, data.qvel, data.act)
    _, sensors = rollout.rollout(model, data, start, controls[:-1])
    measured = np.asarray(sensors)[0]
    rng = np.random.default_rng(0)
    return Recorded(measured + rng.normal(scale=lesson.noise, size=measured.shape), controls)


def write_lesson(path: Path, recorded: Recorded, system: Any) -> None:
    """Write a recording as a CSV file that `na.identify` reads."""
    count, shown = recorded.measured.shape
    states = [f"state.{name}" for name in column_names(system.state)[:shown]]
    controls = [f"control.{name}" for name in column_names(system.control)]
    times = STEP * np.arange(count)
    table = np.column_stack([times, recorded.measured, recorded.controls[:count]])
    header = ",".join(["time s", *states, *controls])
    np.savetxt(path, table, "%.12g", ",", header=header, comments="", encoding="utf-8")


class LessonProblem:
    """A recording as the tutorial gives it to the toolbox: as a whole, from the true start, all else by default."""

    def __init__(self, lesson: Lesson, recorded: Recorded):
        self.lesson = lesson
        self.size = len(lesson.unknowns)
        spec = mujoco.MjSpec.from_string(lesson.model)
        model = spec.compile()
        data = mujoco.MjData(model)
        start = sysid.create_initial_state(model, data.qpos, data.qvel, data.act)
        controls = recorded.controls
        times = STEP * np.arange(len(controls))
        # MuJoCo hands over sensors of a step's start with the time of its end.
        measured = sysid.TimeSeries.from_names(times[1:], recorded.measured, model)
        sequence = sysid.ModelSequences(
            lesson.name, spec, "recording", start, sysid.TimeSeries(times, controls), measured
        )
        self.residuals = sysid.build_residual_fn(models_sequences=[sequence])

    def deviations(self, values: Float[np.ndarray, " P"]) -> Float[np.ndarray, " P"]:
        """Return the standard deviations that the toolbox's report shows, as 95 % intervals: infinite for the undetermined."""
        parameters = self.parameters()
        points = np.column_stack([values, values[:, None] + DIFFERENCE * np.eye(self.size)])
        residuals = np.column_stack(
            [np.concatenate(self.residuals(point, parameters)[0]) for point in points.T]
        )
        slopes = (residuals[:, 1:] - residuals[:, :1]) / DIFFERENCE
        _, intervals = sysid.calculate_intervals([residuals[:, 0]], slopes)
        return intervals / 1.96

    def parameters(self) -> sysid.ParameterDict:
        """Return what it looks for, with first guesses and bounds."""
        parameters = sysid.ParameterDict()
        unknowns = self.lesson.unknowns
        parameters.add(
            sysid.Parameter(
                "body",
                [unknown.first for unknown in unknowns],
                [unknown.low for unknown in unknowns],
                [unknown.high for unknown in unknowns],
                modifier=lambda spec, found: set_parameters(spec, self.lesson, found.value),
            )
        )
        return parameters


def make_emulator(lesson: Lesson, folder: Path) -> Made:
    """Return the emulator of a case's family, from `folder` if it lies there, made as a user makes it."""
    toml = folder / f"{lesson.name}.toml"
    if not toml.exists():
        folder.mkdir(parents=True, exist_ok=True)
        model = toml.with_suffix(".xml")
        model.write_text(lesson.model, encoding="utf-8")
        write_definition(str(model))
        text = toml.read_text(encoding="utf-8")
        text = re.sub(r"(?m)^substeps = .*$", f"substeps = {SUBSTEPS}", text)
        lines = [
            f'{unknown.name} = {{ sets = "{unknown.sets}", range = [{unknown.low}, {unknown.high}] }}'
            for unknown in lesson.unknowns
        ]
        text += "\n[parameters]\n" + "\n".join(lines) + "\n"
        toml.write_text(text, encoding="utf-8")
    case = Case(lesson.name, str(toml.resolve()), TRANSITIONS, {"updates": lesson.updates})
    return made(case, folder)


def lesson_rows(lesson: Lesson, folder: Path) -> Iterator[dict[str, Any]]:
    """Yield the lines of one case: ours, by usual windows and by the whole recording as one window, and the toolbox's.

    All run twice; the second time counts.
    """
    recorded = record_lesson(lesson)
    one = make_emulator(lesson, folder)
    path = folder / f"{lesson.name}.csv"
    write_lesson(path, recorded, system_of(one.emulator))
    making = one.data_seconds + one.training_seconds
    for window in (None, lesson.seconds):
        try:
            row = our_lesson_row(lesson, one, path, window)
        except NeuroAnimatorError as error:
            row = failed_row(lesson, window, str(error))
        yield row | {"making_s": making}
    problem = LessonProblem(lesson, recorded)
    run_toolbox(problem, "mujoco", LIMIT)
    outcome = run_toolbox(problem, "mujoco", LIMIT)
    deviations = problem.deviations(outcome.values)
    yield lesson_row(lesson, "toolbox", outcome.values, deviations) | {
        "cpu_s": outcome.cpu_seconds,
        "wall_s": outcome.seconds,
        "iterations": outcome.iterations,
        "says": "",
        "making_s": 0.0,
    }


def our_lesson_row(lesson: Lesson, one: Made, path: Path, window: float | None) -> dict[str, Any]:
    """Return the line of the second of two `na.identify`, in windows of `window` seconds."""
    na.identify(one.emulator, path, window=window)
    began = time.perf_counter()
    cpu_began = time.process_time()
    found = na.identify(one.emulator, path, window=window)
    cpu_seconds = time.process_time() - cpu_began
    seconds = time.perf_counter() - began
    values = np.array([found.parameters[unknown.name] for unknown in lesson.unknowns])
    deviations = [estimate.deviation for estimate in found.estimates if estimate.is_parameter]
    return lesson_row(lesson, our_method(window), values, np.array(deviations)) | {
        "cpu_s": cpu_seconds,
        "wall_s": seconds,
        "iterations": found.final.iterations,
        "says": " ".join(found.notes),
    }


def our_method(window: float | None) -> str:
    """Return the name of `na.identify` in windows of `window` seconds."""
    return "ours" if window is None else "ours, one window"


def failed_row(lesson: Lesson, window: float | None, message: str) -> dict[str, Any]:
    """Return the line of an identification that ended with an error."""
    nothing = np.full(len(lesson.unknowns), np.nan)
    return lesson_row(lesson, our_method(window), nothing, nothing) | {
        "cpu_s": np.nan,
        "wall_s": np.nan,
        "iterations": 0,
        "says": message,
    }


def lesson_row(
    lesson: Lesson,
    method: str,
    values: Float[np.ndarray, " P"],
    deviations: Float[np.ndarray, " P"],
) -> dict[str, Any]:
    """Return what a line says of the parameters."""
    unknowns = lesson.unknowns
    errors = [
        abs(value - u.true) / (u.high - u.low) for u, value in zip(unknowns, values, strict=True)
    ]
    return {
        "case": f"{lesson.name}, noise {lesson.noise:g}",
        "method": method,
        "worst_error": max(errors),
        "found": " ".join(f"{value:.5g}" for value in values),
        "deviations": " ".join(f"{deviation:.3g}" for deviation in deviations),
    }
