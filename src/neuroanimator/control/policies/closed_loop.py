"""Let a policy drive many bodies at once: along a course on the true physics, or on their own on the emulator."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.control.policies.behaviours import Behaviour
from neuroanimator.control.policies.policy import Policy
from neuroanimator.control.policies.steering import SteeringTarget, command
from neuroanimator.errors import ArgumentError
from neuroanimator.systems.fastest import play
from neuroanimator.systems.system import Runs, System


def decide(
    policy: Policy, latent: Float[Array, "B I"], phase: Float[Array, " B"], course: SteeringTarget
) -> Float[Array, "B C"]:
    """Return the controls of bodies that feel `latent` at `phase` [rad] of their clocks. For use inside jit."""
    return jax.vmap(policy.control)(latent, phase, command(course, policy.pose(latent)))


def live(
    policy: Policy, behaviour: Behaviour, starts: np.ndarray, steps: int, *, seed: int = 0
) -> Float[Array, "B T+1 S"]:
    """Return what bodies from `starts` (B, S) do on the emulator if each always goes where `behaviour` says.

    Clocks begin at random, so that bodies do not beat in time.

    Raises ArgumentError for starts of another shape.
    """
    checked = policy.emulator.spec.state.check(starts, "starts")
    if checked.ndim != 2 or steps < 1:
        raise ArgumentError(
            f"starts and steps: wanted (B, S) and at least 1, came {checked.shape} and {steps}."
        )
    phase = jax.random.uniform(jax.random.key(seed), (len(checked),), maxval=2 * jnp.pi)
    return _live(policy, behaviour, jnp.asarray(checked, jnp.float32), phase, steps)


@eqx.filter_jit
def _live(policy: Policy, behaviour: Behaviour, starts: Array, phase: Array, steps: int) -> Array:
    emulator = policy.emulator

    def advance(state: tuple[Array, Array], time: Array) -> tuple[tuple[Array, Array], Array]:
        latent, phase = state
        controls = decide(policy, latent, phase, behaviour(policy.pose(latent), time))
        following = jax.vmap(emulator.advance)(latent, emulator.encode_control(controls))
        return (following, (phase + policy.tick) % (2 * jnp.pi)), following

    path = jax.lax.scan(advance, (emulator.encode(starts), phase), jnp.arange(steps) * policy.dt)[1]
    return jnp.concatenate([starts[:, None], jnp.swapaxes(emulator.decode(path), 0, 1)], axis=1)


_decide = eqx.filter_jit(decide)


def drive(
    policy: Policy, system: System, starts: np.ndarray, course: SteeringTarget, steps: int
) -> tuple[Runs, np.ndarray]:
    """Return what bodies from `starts` (B, S) do on the true physics along their courses, and the controls (B, T, C).

    A body whose physics blew up stays where it was.
    """
    states, controls = [np.asarray(starts, float)], []
    is_alive, phase = np.ones(len(starts), bool), np.zeros(len(starts))
    for _ in range(steps):
        latent = jnp.asarray(policy.emulator.encode(states[-1]), jnp.float32)
        given = np.asarray(_decide(policy, latent, jnp.asarray(phase, jnp.float32), course), float)
        given = system.bounds.clip(given)  # float32 may round beyond a bound
        runs = play(system, states[-1], given[:, None], policy.dt)
        is_alive &= runs.is_alive
        states.append(np.where(is_alive[:, None], runs.states[:, -1], states[-1]))
        controls.append(given)
        phase = (phase + policy.tick) % (2 * np.pi)
    return Runs(np.stack(states, axis=1), is_alive), np.stack(controls, axis=1)
