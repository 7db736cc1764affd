"""An emulator as it is used from Python: super steps, rollouts, trust, and its file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from neuroanimator.emulator import artifact, runner
from neuroanimator.emulator.arrays import as_float32
from neuroanimator.emulator.error_bounds import KINDS, USUAL_LEVEL
from neuroanimator.emulator.spec import MAX_STRIDES
from neuroanimator.emulator.super_step import SuperStep
from neuroanimator.emulator.trust import EDGE
from neuroanimator.emulator.verdict import Verdict, judge_bounds
from neuroanimator.errors import ArgumentError
from neuroanimator.files.zoo import find_emulator, is_name
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.parameters import fixed_parameters
from neuroanimator.state.start import start_state


class Emulator(SuperStep):
    """A network that leaps a system one super step ahead, from Python and inside `jax.jit`, `jax.grad` and `jax.vmap`."""

    @property
    def verdict(self) -> Verdict | None:
        """Whether it is of any use where it was trained, and why, from what its file tells; None where that tells nothing.

        `trust` says how near that is.
        """
        if self.validation is not None:
            return self.validation.verdict
        if self.calibration is not None:
            return judge_bounds(self.calibration)
        return None

    @property
    def step(self) -> runner.Step:
        """`step(state (S,), control (C,))` is the state (S,) `dt` seconds later: see `Step.__call__`.

        A function that can be called from Python, and given to `jax.jit`,
        `jax.grad` and `jax.vmap`.
        """
        return runner.Step(self)

    def rollout(
        self, state: ArrayLike, controls: ArrayLike, *, may_diverge: bool = False
    ) -> Float[AnyArray, "*B F S"]:
        """Return the trajectory (T+1, S) from `state` (S,) under `controls` (T, C), the start included.

        A batch is `state` (B, S) with `controls` (B, T, C). With `may_diverge`, numbers that are not finite are
        returned where the motion comes to that. Of arrays of JAX it is one of JAX; of all else it is one of
        NumPy, computed by the `backend`. Inside `jax.jit`, `jax.grad` and `jax.vmap` nothing but shapes is checked.

        Raises ArgumentError for wrong shapes, for numbers that are not finite or larger than `MAX_MAGNITUDE`, and
        for states no motion follows from; DivergedError where a motion ends in numbers that are not finite.
        """
        return runner.run_rollout(self, state, controls, may_diverge=may_diverge)

    def rollout_trusted(
        self, state: ArrayLike, controls: ArrayLike, *, may_diverge: bool = False
    ) -> tuple[Float[np.ndarray, "*B F S"], Float[np.ndarray, "*B T"]]:
        """Return (`rollout`, the score (T,) of each super step: see `trust`), for little more than the cost of the rollout.

        Scores are infinite where numbers are not finite. Always arrays of NumPy; not for use inside jit, grad and vmap.

        Raises what `rollout` does.
        """
        return runner.run_rollout_trusted(self, state, controls, may_diverge=may_diverge)

    def trust(self, state: ArrayLike, control: ArrayLike) -> Float[np.ndarray, " *B"]:
        """Return how far `state` (..., S) with `control` (..., C) lies from what this emulator was trained on.

        1 is the edge: 99 of a hundred super steps of training lie within it. The more above it, the less is known. It is
        the disagreement that last layers as likely as the one it has would come to (`TrustMeter`), and how far
        features leave their ranges. Infinite for what is not finite. Files from before there was a
        meter know the ranges alone: inside them the score is 0.

        It asks about states as they are, such as the physics' or recorded ones. For a motion that this emulator made ask
        `rollout_trusted`: super steps go on from latent states, and encoding what was decoded gives a deformable
        body's shape back only nearly.

        Raises ArgumentError for wrong shapes.
        """
        return runner.run_trust(self, state, control)

    def error_bounds(
        self,
        state: ArrayLike,
        controls: ArrayLike,
        *,
        level: float = USUAL_LEVEL,
        are_optimised: bool = False,
    ) -> Float[np.ndarray, "*B T"]:
        """Return what the error of `rollout` stays below after each super step (T,), in a share `level` of motions.

        The error is the root mean square over all numbers of the state that move, in standard deviations of their usual
        change in a super step (`calibration.unit`). The bound grows with the scores on the way (`trust`). It was measured
        on runs that training left out, under controls as in training; say `are_optimised` of controls that were found by
        descending through this emulator, which lead where it errs more. Infinite after more super steps than were measured.

        Raises ArgumentError for a level there is no bound of, for an emulator whose errors nobody measured (see
        `fit_error_bounds`), and for what `rollout` refuses.
        """
        calibration = self.calibration
        if calibration is None:
            raise ArgumentError(
                f"{self.system}: this emulator brings no error bounds. na.fit_error_bounds(emulator) measures them."
            )
        if level not in calibration.levels:
            levels = ", ".join(f"{known:g}" for known in calibration.levels)
            raise ArgumentError(f"level: wanted one of {levels}, came {level}.")
        if are_optimised and not calibration.knows_optimised:
            raise ArgumentError(
                f"are_optimised: {self.system} was measured under random controls alone, for it cannot be simulated."
            )
        _, scores = self.rollout_trusted(state, controls, may_diverge=True)
        return calibration.along(np.asarray(scores, float), level, KINDS[are_optimised])

    def covers(self, state: ArrayLike, control: ArrayLike) -> bool:
        """Return whether `state` (S,) with `control` (C,) is what this emulator was trained on: `trust` says at most 1.

        Controls are covered between their bounds. What is not finite is covered nowhere.

        Raises ArgumentError for wrong shapes.
        """
        is_known = bool(np.all(self.trust(state, control) <= EDGE))
        return is_known and self.bounds.contain(np.asarray(control, float))

    def save(self, path: str | Path) -> None:
        """Write the emulator as one `.safetensors` file."""
        artifact.save(self, Path(path))

    @classmethod
    def load(cls, path: str | Path) -> Emulator:
        """Return the emulator in the file at `path`, or the one that ships under the name `path`: "fish-50".

        A name has no folder and no suffix. BadFileError says what is wrong with a file, and lists the names.
        """
        file = find_emulator(path) if isinstance(path, str) and is_name(path) else Path(path)
        return artifact.load(file, cls)

    def at(self, /, **values: float) -> Emulator:
        """Return the emulator of the body with the parameters given, which `rest` holds: motions begin there.

        `emulator.at(forearm_mass=1.3)`. Parameters are entries of the state, so that a gradient in a state is one in them.

        Raises ArgumentError for a name that is no parameter, and for a value beyond those it was trained on.
        """
        fixed_parameters(self.parameters, values)
        rest = start_state(self.state, self.spec.rest, values, cloud=self.state_structure.cloud)
        return replace(self, spec=replace(self.spec, rest=tuple(rest.tolist())))

    def in_strides(self, count: int) -> Emulator:
        """Return the emulator whose super step is `count` of this one's in a row, under one control: its strides.

        It costs `count` times as much, and is nearer to the physics than one leap as long wherever a shorter one is easier to
        learn: see `docs/decisions/0017-strides.md`.

        Raises ArgumentError if that are more strides than a file may have.
        """
        strides = self.strides * count
        if not 1 <= strides <= MAX_STRIDES:
            raise ArgumentError(f"count: wanted 1 to {MAX_STRIDES} strides in all, came {strides}.")
        spec = replace(
            self.spec, substeps=self.substeps * count, dt=self.dt * count, strides=strides
        )
        # Neighbouring strides change the state alike, so that their changes add up.
        normaliser = replace(self.normaliser, unit=self.normaliser.unit * count)
        # What was measured of single strides says nothing of super steps.
        return replace(self, spec=spec, normaliser=normaliser, calibration=None, validation=None)

    def rest_streams(self) -> tuple[Float[Array, " O"], Float[Array, " E"]]:
        """Return what the network sees at rest without control; left and right are alike there, to the last bit."""
        latent = np.asarray(self.encode(self.rest))
        control = np.asarray(self.encode_control(self.bounds.idle))
        raw = np.asarray(self.raw_features(latent, control))
        return _streams_at_rest(self, as_float32(latent), as_float32(raw))

    def at_rest(self, streams: tuple[Float[Array, " O"], Float[Array, " E"]]) -> Emulator:
        """Return the emulator that stays at rest: what the network says of it, `rest_streams`, is taken away.

        Only for systems that keep still there. It costs nothing: the mean change takes it up.
        """
        change_at_rest = self.normaliser.change_scale * self.network(*streams)
        normaliser = replace(self.normaliser, change_mean=0.0 - change_at_rest)
        return replace(self, normaliser=normaliser)

    def __repr__(self) -> str:
        spec = self.spec
        network = type(self.network).__name__.lower()
        widths = "x".join(map(str, self.network.widths))
        strides = f" in {spec.strides} strides" if spec.strides > 1 else ""
        verdict = f", {self.verdict.word}" if self.verdict else ""
        return (
            f'Emulator("{spec.system}", {spec.substeps} substeps, dt {spec.dt:g} s, '
            f"{spec.state.size} states, {spec.control.size} controls, {network} {widths}{strides}{verdict})"
        )


@eqx.filter_jit
def _streams_at_rest(
    emulator: Emulator, latent: Float[AnyArray, " I"], raw: Float[AnyArray, " K"]
) -> tuple[Float[Array, " O"], Float[Array, " E"]]:
    """Return what the network sees of `latent` and its `raw` features, where left and right are alike."""
    plain = emulator.normaliser.forward(emulator.domain.clip(raw))
    odd, even = emulator.features.streams(latent, plain)
    if emulator.features.is_odd:
        odd = jnp.zeros_like(odd)
    return odd, even


def as_emulator(reference: Emulator | str | Path) -> Emulator:
    """Return an emulator as it is; of a file's or a system's name, the emulator that verbs take for it."""
    if isinstance(reference, Emulator):
        return reference
    return Emulator.load(find_emulator(str(reference)))


def load_emulator(name: str | Path) -> Emulator:
    """Return the emulator that ships under `name`, such as "fish-50", or the one in the file of that name.

    BadFileError says what is wrong with a file, and lists the names.
    """
    return Emulator.load(name)
