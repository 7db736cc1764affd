"""An objective in generated C: residuals of a motion, and what cotangents of them say of its states and controls.

The program is known by the objective's form: its numbers (weights, goals, tolerances) go in with every call, so that
another goal of the same kind needs no other program. Costs that are any JAX function are left to JAX.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.codegen.c_function import CFunction, c_function, prelude
from neuroanimator.codegen.kept import (
    CProgram,
    LoadedProgram,
    WrongProgramError,
    aligned,
    load_program,
)
from neuroanimator.codegen.program import WIDTH, Constants
from neuroanimator.codegen.trace import Input, UnsupportedError, numbers_computed
from neuroanimator.control.objective.objective import Objective
from neuroanimator.control.objective.trajectory import Trajectory
from neuroanimator.emulator.c_emulator import pointer
from neuroanimator.emulator.probes import GRADIENT_TOLERANCE, compiled_quickly
from neuroanimator.storage.remembered import UNKNOWN, Remembered

OURS = "neuroanimator."
"""Cost terms of the package: their code is part of what a program is known by; others' is not."""

MOST_SCRATCH = 2**22
"""Bytes a program may need on the stack: half of what threads have."""

MOST_NUMBERS = 10_000
"""An objective that computes more is left to JAX: terms that look at all points of a body all along become programs that
take a minute to compile."""

TRIED = 3
"""Random motions a program is compared with JAX on."""

Lanes = Float[np.ndarray, "... 16"]


@dataclass(frozen=True)
class MotionShape:
    """What the motions are that an objective judges."""

    steps: int
    state: int
    """Numbers of a state."""
    control: int
    """Numbers of a control."""
    dt: float
    """[s]"""


@dataclass(frozen=True, eq=False)
class CObjective:
    """The program of an objective's form with one objective's numbers. Arrays are float32 in C's order."""

    program: LoadedProgram
    numbers: Float[np.ndarray, " P"]
    """Those of the objective, then the scale of each control."""

    def of_states(
        self, states: Float[np.ndarray, "T1 S"], controls: Float[np.ndarray, "T C"]
    ) -> tuple[Float[np.ndarray, " R"], np.ndarray]:
        """Return (the residuals of the terms that look at states, the tape)."""
        residuals = np.empty(self.program.sizes["of_states"], np.float32)
        return residuals, forward(
            self.program, "states", [self.numbers, states, controls], residuals
        )

    def of_controls(
        self, controls: Float[np.ndarray, "T C"]
    ) -> tuple[Float[np.ndarray, " Q"], np.ndarray]:
        """Return (the residuals of the terms that look at controls alone, the tape)."""
        residuals = np.empty(self.program.sizes["of_controls"], np.float32)
        return residuals, forward(self.program, "efforts", [self.numbers, controls], residuals)

    def pull_states(
        self, tape: np.ndarray, cotangents: Lanes, of_states: Lanes, of_controls: Lanes
    ) -> None:
        """Fill the last two with what cotangents of the states' residuals say of states and controls."""
        backward(self.program, "states", tape, cotangents, of_states, of_controls)

    def pull_controls(self, tape: np.ndarray, cotangents: Lanes, of_controls: Lanes) -> None:
        """Fill the last one with what cotangents of the controls' residuals say of the controls."""
        backward(self.program, "efforts", tape, cotangents, of_controls)

    def cost(self, states: Float[np.ndarray, "T1 S"], controls: Float[np.ndarray, "T C"]) -> float:
        """Return J of a motion."""
        of_states, _ = self.of_states(states, controls)
        of_controls, _ = self.of_controls(controls)
        return half_squares(of_states) + half_squares(of_controls)

    def cost_and_slopes(
        self, states: Float[np.ndarray, "T1 S"], controls: Float[np.ndarray, "T C"]
    ) -> tuple[float, tuple[Float[np.ndarray, "T1 S"], Float[np.ndarray, "T C"]]]:
        """Return (J, (how it changes with the states, how it changes with the controls))."""
        residuals, tape = self.of_states(states, controls)
        efforts, effort_tape = self.of_controls(controls)
        by_states = lanes(*states.shape)
        by_controls = lanes(*controls.shape)
        self.pull_states(tape, in_first_lane(residuals), by_states, by_controls)
        by_effort = lanes(*controls.shape)
        self.pull_controls(effort_tape, in_first_lane(efforts), by_effort)
        slopes = (by_states[..., 0], by_controls[..., 0] + by_effort[..., 0])
        return half_squares(residuals) + half_squares(efforts), slopes


def in_first_lane(residuals: Float[np.ndarray, " R"]) -> Lanes:
    """Return the cotangents that make J's slope of residuals: these themselves, in one lane."""
    result = lanes(len(residuals))
    result[:, 0] = residuals
    return result


def half_squares(residuals: Float[np.ndarray, " R"]) -> float:
    """Return half the sum of squares."""
    exact = residuals.astype(float)
    return float(exact @ exact) / 2


def forward(
    program: LoadedProgram, name: str, inputs: list[np.ndarray], output: np.ndarray
) -> np.ndarray:
    """Fill `output` with the value of a differentiated function, and return the tape that `backward` needs."""
    tape = aligned_room(program.sizes[name] + WIDTH)
    arrays = [program.constants, *inputs, tape, NOTHING, output]
    getattr(program.library, f"{name}_forward")(*map(pointer, arrays))
    return tape


def backward(
    program: LoadedProgram, name: str, tape: np.ndarray, cotangents: Lanes, *outputs: np.ndarray
) -> None:
    """Fill `outputs` with what sixteen cotangents of the function's value say of its inputs."""
    arrays = [program.constants, tape, NOTHING, cotangents, *outputs]
    getattr(program.library, f"{name}_backward")(*map(pointer, arrays))


def aligned_room(count: int) -> Float[np.ndarray, " N"]:
    """Return `count` zeros that begin where the widest register may."""
    return aligned(np.zeros(count, np.float32))


def lanes(*shape: int) -> Lanes:
    """Return zeros with sixteen lanes."""
    return aligned_room(int(np.prod(shape)) * WIDTH).reshape(*shape, WIDTH)


NOTHING = aligned_room(WIDTH)
"""Stands for a tape of lanes where there is none."""


def cotangents(*shape: int) -> Input:
    """Return the input of sixteen cotangents of a value of this shape."""
    return Input(shape, is_wide=True, is_late=True)


@dataclass(frozen=True)
class _Form:
    """An objective without its numbers, and the motions it judges."""

    objective: Objective
    shape: MotionShape

    @property
    def sizes(self) -> list[int]:
        """How many numbers each array of the objective has; then how many controls have a scale."""
        return [np.size(leaf) for leaf in jax.tree.leaves(self.objective)] + [self.shape.control]

    def about(self) -> str:
        """Return all that the program depends on."""
        shapes = [np.shape(leaf) for leaf in jax.tree.leaves(self.objective)]
        structure = jax.tree.structure(self.objective)
        return "\n".join(["objective", str(structure), str(shapes), str(self.shape)])

    def _judge(
        self, numbers: Float[Array, " P"], states: Array, controls: Array
    ) -> tuple[Objective, Trajectory]:
        """Return the objective with these numbers, and the motion it judges."""
        leaves, structure = jax.tree.flatten(self.objective)
        *parts, scale = jnp.split(numbers, np.cumsum(self.sizes)[:-1])
        shaped = [part.reshape(np.shape(leaf)) for part, leaf in zip(parts, leaves, strict=True)]
        objective = jax.tree.unflatten(structure, shaped)
        return objective, Trajectory(states, controls, scale, self.shape.dt)

    def of_states(
        self,
        numbers: Float[Array, " P"],
        states: Float[Array, "T1 S"],
        controls: Float[Array, "T C"],
    ) -> Float[Array, " R"]:
        """Return the residuals of the terms that look at states."""
        objective, motion = self._judge(numbers, states, controls)
        return objective.apart()[0].residuals(motion)

    def of_controls(
        self, numbers: Float[Array, " P"], controls: Float[Array, "T C"]
    ) -> Float[Array, " Q"]:
        """Return the residuals of the terms that look at controls alone."""
        still = jnp.zeros((self.shape.steps + 1, self.shape.state))
        objective, motion = self._judge(numbers, still, controls)
        return objective.apart()[1].residuals(motion)

    def write(self) -> CProgram:
        """Return the program of both, forward and backward with sixteen cotangents."""
        self._check_size()
        constants = Constants()
        numbers = Input((sum(self.sizes),))
        states = Input((self.shape.steps + 1, self.shape.state))
        controls = Input((self.shape.steps, self.shape.control))
        zeros = [jnp.zeros(entry.shape) for entry in (numbers, states, controls)]
        states_count = jax.eval_shape(self.of_states, *zeros).shape[0]
        controls_count = jax.eval_shape(self.of_controls, zeros[0], zeros[2]).shape[0]

        def pull_states(_: None, numbers: Array, states: Array, controls: Array, of: Array) -> Any:
            value, pull = jax.vjp(partial(self.of_states, numbers), states, controls)
            return value, *pull(of)

        def pull_controls(_: None, numbers: Array, controls: Array, of: Array) -> Any:
            value, pull = jax.vjp(partial(self.of_controls, numbers), controls)
            return value, *pull(of)

        write = partial(c_function, module=None, constants=constants, is_public=True)
        parts = {
            "states": write(
                "states", pull_states, inputs=[numbers, states, controls, cotangents(states_count)]
            ),
            "efforts": write(
                "efforts", pull_controls, inputs=[numbers, controls, cotangents(controls_count)]
            ),
        }
        counts = {"of_states": states_count, "of_controls": controls_count}
        return program_of_parts(parts, constants, counts)

    def _check_size(self) -> None:
        """Raise UnsupportedError for an objective whose program would be too large."""
        rows = self.shape.steps + 1
        shapes = [(sum(self.sizes),), (rows, self.shape.state), (rows - 1, self.shape.control)]
        if numbers_computed(self.of_states, *shapes) > MOST_NUMBERS:
            raise UnsupportedError("objective of so many numbers")

    def check(self, rest: Float[np.ndarray, " S"], in_c: CObjective) -> None:
        """Compare residuals and their gradients about random motions with JAX."""
        rng = np.random.default_rng(0)
        numbers = jnp.asarray(in_c.numbers)
        judge_states = pulled_in_jax(partial(self.of_states, numbers))
        judge_controls = pulled_in_jax(partial(self.of_controls, numbers))
        for _ in range(TRIED):
            noise = rng.normal(size=(self.shape.steps + 1, self.shape.state))
            states = (rest + 0.1 * noise).astype(np.float32)
            controls = rng.normal(size=(self.shape.steps, self.shape.control)).astype(np.float32)
            residuals, tape = in_c.of_states(states, controls)
            of = random_lanes(rng, len(residuals))
            found = (lanes(*states.shape), lanes(*controls.shape))
            in_c.pull_states(tape, of, *found)
            compare_pulled((residuals, *found), judge_states(states, controls, of))
            residuals, tape = in_c.of_controls(controls)
            of = random_lanes(rng, len(residuals))
            of_controls = lanes(*controls.shape)
            in_c.pull_controls(tape, of, of_controls)
            compare_pulled((residuals, of_controls), judge_controls(controls, of))


def program_of_parts(
    parts: dict[str, CFunction], constants: Constants, counts: dict[str, int]
) -> CProgram:
    """Return the program of differentiated functions by their names; its sizes are `counts`, and the tapes by name."""
    if max(part.scratch for part in parts.values()) > MOST_SCRATCH:
        raise UnsupportedError("objective of so long a motion")
    sizes = counts | {name: part.tape for name, part in parts.items()}
    text = "\n".join([prelude(), *(part.text for part in parts.values())])
    return CProgram(text, constants.data(), sizes)


def random_lanes(rng: np.random.Generator, *shape: int) -> Lanes:
    """Return random cotangents."""
    result = lanes(*shape)
    result[:] = rng.normal(size=result.shape)
    return result


def pulled_in_jax(function: Callable[..., Any]) -> Callable[..., tuple[Array, ...]]:
    """Return (inputs..., sixteen cotangents of the value) → (value, what they say of each input), compiled."""

    def value_and_pulled(*arrays: Array) -> tuple[Array, ...]:
        *inputs, of = arrays
        value, pull = jax.vjp(function, *inputs)
        return value, *jax.vmap(pull, in_axes=-1, out_axes=-1)(of)

    return compiled_quickly(value_and_pulled)


def compare_pulled(found: Iterable[np.ndarray], expected: Iterable[Array]) -> None:
    """Raise WrongProgramError unless a value and what cotangents say of its inputs are those of JAX."""
    for mine, wanted in zip(found, expected, strict=True):
        size = float(np.abs(wanted).max(initial=1e-6))
        off = np.abs(mine - np.asarray(wanted)).max(initial=0)
        if not off <= GRADIENT_TOLERANCE * size:
            raise WrongProgramError("Generated C has another cost, or other gradients, than JAX.")


_known: Remembered[CObjective | None] = Remembered()
"""The program of each objective, by the motions it judges and the scale of their controls."""


def c_objective(
    objective: Objective,
    shape: MotionShape,
    scale: Float[np.ndarray, " C"],
    rest: Float[np.ndarray, " S"],
) -> CObjective | None:
    """Return `objective` in C for motions of a `shape`, whose controls count as full effort at `scale`.

    None where there is no such program: without a compiler, for costs that are any JAX function, and for terms that
    are not the package's own. A program that does not do what JAX does about the state `rest` is refused, which is
    said once.
    """
    key = (shape, scale.tobytes())
    known = _known.of(objective, *key)
    if known is not UNKNOWN:
        return known
    return _known.keep(_load(_Form(objective, shape), scale, rest), objective, *key)


def _load(
    form: _Form, scale: Float[np.ndarray, " C"], rest: Float[np.ndarray, " S"]
) -> CObjective | None:
    objective = form.objective
    if objective.functions or not objective.terms:
        return None
    if not all(type(term).__module__.startswith(OURS) for term in objective.terms):
        return None
    leaves = [np.ravel(leaf) for leaf in jax.tree.leaves(objective)]
    numbers = aligned(np.concatenate([*leaves, scale]).astype(np.float32))

    def check(program: LoadedProgram) -> None:
        form.check(rest, CObjective(program, numbers))

    program = load_program(form.about(), form.write, check)
    return None if program is None else CObjective(program, numbers)
