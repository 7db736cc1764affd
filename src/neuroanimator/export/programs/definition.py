"""Definition of a program for an engine: a function of arrays, in the user's own units, and the meaning of its numbers."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

import neuroanimator
from neuroanimator.control.policies.commands import COMMAND_LAYOUT, Commands
from neuroanimator.control.policies.policy import COMMAND, Policy
from neuroanimator.control.policies.state_policy import StatePolicy
from neuroanimator.emulator.checks import MAX_MAGNITUDE
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.super_step import begin, step, step_trusted
from neuroanimator.emulator.trust_summary import NO_METER
from neuroanimator.state.layout import Bounds, Layout, Slice

PHASE = Layout((Slice("phase", 1, "rad"),))
"""The clock of a policy."""

TRUST = Layout((Slice("trust", 1, "1"),))
"""Trust score: the distance of an input from the training data, 1 at their edge."""

MAX_SCORE = 1e30
"""Score above which it counts as infinite: float32 ends soon after."""

CONVENTIONS = "SI units, radians, Z up, right-handed, quaternions wxyz"
"""Conventions of all numbers; docs/conventions.md says more."""


Model = Emulator | Policy | StatePolicy
"""Models that can be written as a program."""


class Port(NamedTuple):
    """An input or output: named numbers of one example."""

    name: str
    layout: Layout


@dataclass(frozen=True, eq=False)
class ProgramDefinition:
    """A function in JAX, of one example, and facts about it."""

    name: str
    """Name of the function."""
    function: Callable[..., tuple[Array, ...]]
    """Function of one array for each of `inputs`; it returns one for each of `outputs`."""
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    facts: dict[str, Any]
    """Facts for engines, as JSON: the system, the super step, names, units and bounds."""
    missing: str = ""
    """Sentence on what an older model lacks, and the remedy."""

    @property
    def output_names(self) -> list[str]:
        """Names of the outputs."""
        return [port.name for port in self.outputs]

    def fact_texts(self) -> dict[str, str]:
        """Return the facts as texts; others than texts as JSON in ASCII."""
        texts = {}
        for name, fact in self.facts.items():
            texts[name] = fact if isinstance(fact, str) else json.dumps(fact)
        return texts


def definition_of(model: Model, licence: str = "", *, has_trust: bool = False) -> ProgramDefinition:
    """Return the program of `model`; `licence` gives the terms of use of its weights.

    An emulator: (state (S,), control (C,)) → next_state (S,), one super step later; with `has_trust` also trust (1,), if
    it has a meter. A policy: (state (S,), phase (1,), command (4,)) → control (C,), for the super step that begins there;
    the phase of its clock advances by `phase_per_step` with every super step. A state policy: state (S,) → control (C,); one that
    takes commands: (state (S,), command (2,)) → (control (C,), commanded_state (S,)), the state from which the super step
    begins.
    """
    if isinstance(model, Policy):
        return _policy_definition(model, licence)
    if isinstance(model, StatePolicy):
        commands = commands_of(model)
        if commands is not None:
            return _commanded_definition(model, commands, licence)
        return ProgramDefinition(
            name="control",
            function=partial(_state_answer, model),
            inputs=(Port("state", model.emulator.state),),
            outputs=(Port("control", model.emulator.control),),
            facts=_facts("state-policy", model.emulator, licence),
        )
    definition = ProgramDefinition(
        name="step",
        function=partial(_super_step, model),
        inputs=(Port("state", model.state), Port("control", model.control)),
        outputs=(Port("next_state", model.state),),
        facts=_facts("emulator", model, licence),
    )
    if not has_trust:
        return definition
    if model.meter is None:
        return replace(definition, missing=f"No trust: {NO_METER}.")
    outputs = (*definition.outputs, Port("trust", TRUST))
    return replace(definition, function=partial(_trusted_step, model), outputs=outputs)


def commands_of(model: Model) -> Commands | None:
    """Return the commands that a state policy takes; None for one without, and for any other model."""
    if not isinstance(model, StatePolicy) or model.view.reference is None:
        return None
    return model.view.reference.commands


def emulator_of(model: Model) -> Emulator:
    """Return the emulator of a policy; an emulator itself."""
    return model if isinstance(model, Emulator) else model.emulator


def _super_step(
    emulator: Emulator, state: Float[Array, " S"], control: Float[Array, " C"]
) -> tuple[Float[Array, " S"]]:
    return (step(emulator, state, control),)


def _trusted_step(
    emulator: Emulator, state: Float[Array, " S"], control: Float[Array, " C"]
) -> tuple[Float[Array, " S"], Float[Array, " 1"]]:
    following, score = step_trusted(emulator, state, control)
    is_number = _are_below(state, MAX_MAGNITUDE) & _are_below(control, MAX_MAGNITUDE)
    is_number &= _are_below(score, MAX_SCORE)
    return following, jnp.where(is_number, score, jnp.inf)[None]


def _are_below(numbers: Float[Array, " *N"], limit: float) -> Bool[Array, ""]:
    """Return whether the magnitudes of all `numbers` are at most `limit`; false if one is NaN.

    They are counted, as runtimes disagree on the maximum of numbers with a NaN among them.
    """
    is_below = jnp.abs(numbers) <= limit
    return jnp.sum(is_below.astype(jnp.float32)) == numbers.size


def _policy_definition(policy: Policy, licence: str) -> ProgramDefinition:
    emulator = policy.emulator
    facts = _facts("policy", emulator, licence) | _command_facts(COMMAND, policy.ranges)
    facts["phase_per_step"] = policy.tick
    return ProgramDefinition(
        name="control",
        function=partial(_answer, policy),
        inputs=(Port("state", emulator.state), Port("phase", PHASE), Port("command", COMMAND)),
        outputs=(Port("control", emulator.control),),
        facts=facts,
    )


def _answer(
    policy: Policy,
    state: Float[Array, " S"],
    phase: Float[Array, " 1"],
    command: Float[Array, " 4"],
) -> tuple[Float[Array, " C"]]:
    _, latent = begin(policy.emulator, state)
    return (policy.control(latent, jnp.reshape(phase, ()), command),)


def _state_answer(policy: StatePolicy, state: Float[Array, " S"]) -> tuple[Float[Array, " C"]]:
    return (policy.control_of(state),)


def _commanded_definition(
    policy: StatePolicy, commands: Commands, licence: str
) -> ProgramDefinition:
    emulator = policy.emulator
    return ProgramDefinition(
        name="control",
        function=partial(commanded_control, policy),
        inputs=(Port("state", emulator.state), Port("command", COMMAND_LAYOUT)),
        outputs=(Port("control", emulator.control), Port("commanded_state", emulator.state)),
        facts=_facts("commanded-policy", emulator, licence)
        | _command_facts(COMMAND_LAYOUT, commands.bounds),
    )


def commanded_control(
    policy: StatePolicy, state: Float[Array, " S"], command: Float[Array, " 2"]
) -> tuple[Float[Array, " C"], Float[Array, " S"]]:
    """Return (the control of a body in `state` under `command`, its state with the command in it)."""
    reference = policy.view.reference
    assert reference is not None
    told = reference.with_command(state, command)
    return policy.control_of(told), told


def _command_facts(layout: Layout, bounds: Bounds) -> dict[str, Any]:
    return {
        "command": layout.to_json(),
        "command_low": list(bounds.low),
        "command_high": list(bounds.high),
    }


def _facts(kind: str, emulator: Emulator, licence: str) -> dict[str, Any]:
    facts = {
        "kind": kind,
        "system": emulator.system,
        "dt": emulator.dt,
        "substeps": emulator.substeps,
        "state": emulator.state.to_json(),
        "control": emulator.control.to_json(),
        "control_low": list(emulator.bounds.low),
        "control_high": list(emulator.bounds.high),
        "rest": list(emulator.spec.rest),
        "conventions": CONVENTIONS,
        "generator": f"neuroanimator {neuroanimator.__version__}",
    }
    if licence:
        facts["licence"] = licence
    return facts
