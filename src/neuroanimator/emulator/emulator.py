"""The emulator as used from Python: super steps, rollouts, trust, and its file."""

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
        """Whether it is of use within its training, and why, from its file; None if the file has no errors.

        `trust` tells how near a state is to that.
        """
        if self.validation is not None:
            return self.validation.verdict
        if self.calibration is not None:
            return judge_bounds(self.calibration)
        return None

    @property
    def step(self) -> runner.StepCall:
        """`step(state (S,), control (C,))` is the state (S,) `dt` seconds later: see `StepCall.__call__`.

        A function to be called from Python, or passed to `jax.jit`,
        `jax.grad` and `jax.vmap`.
        """
        return runner.StepCall(self)

    def rollout(
        self, state: ArrayLike, controls: ArrayLike, *, may_diverge: bool = False
    ) -> Float[AnyArray, "*B F S"]:
        """Return the trajectory (T+1, S) from `state` (S,) under `controls` (T, C), the start included.

        A batch is `state` (B, S) with `controls` (B, T, C). With `may_diverge`, a motion that diverges is returned
        with numbers that are not finite. For JAX arrays the result is a JAX array; otherwise it is a
        NumPy array, computed by the `backend`, in float32 if `state` is, else in float64. Inside `jax.jit`, `jax.grad` and
        `jax.vmap` only shapes are checked.

        A motion far away is the same as at the origin: see `docs/decisions/0039-far-away.md`.

        Raises ArgumentError for wrong shapes, for numbers that are not finite or larger than `MAX_MAGNITUDE`, and
        for states from which no motion follows; DivergedError for a motion that ends in numbers that are not finite.
        """
        return runner.run_rollout(self, state, controls, may_diverge=may_diverge)

    def rollout_trusted(
        self, state: ArrayLike, controls: ArrayLike, *, may_diverge: bool = False
    ) -> tuple[Float[np.ndarray, "*B F S"], Float[np.ndarray, "*B T"]]:
        """Return (`rollout`, the score (T,) of each super step: see `trust`), for little more than the cost of the rollout.

        Scores are infinite where numbers are not finite. Always NumPy arrays; not for use inside jit, grad and vmap.

        Raises what `rollout` raises.
        """
        return runner.run_rollout_trusted(self, state, controls, may_diverge=may_diverge)

    def trust(self, state: ArrayLike, control: ArrayLike) -> Float[np.ndarray, " *B"]:
        """Return the score (...) of `state` (..., S) with `control` (..., C): its distance from this emulator's training.

        1 is the edge: 99 of a hundred super steps of training lie within it. The higher above it, the less is known. The
        score combines the disagreement among equally likely last layers (`TrustMeter`) with how far
        features leave their ranges. It is infinite for numbers that are not finite. Older files without a
        meter know only the ranges: inside them the score is 0.

        It is for given states, such as the physics' or recorded ones. For a motion of this emulator use
        `rollout_trusted`: super steps continue from latent states, and encoding a decoded state reproduces a deformable
        body's shape only approximately.

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
        """Return bounds of the error of `rollout` after each super step (T,), which hold for a share `level` of motions.

        The error is the root mean square over all numbers of the state that move, in standard deviations of their usual
        change in a super step (`calibration.unit`). The bound grows with the scores on the way (`trust`). It was measured
        on runs held out from training, under controls as in training; set `are_optimised` for controls found by
        descending through this emulator, which lead where it errs more. Infinite after more super steps than were measured.

        Raises ArgumentError for a level without a bound, for an emulator whose errors were not measured (see
        `fit_error_bounds`), and for what `rollout` refuses.
        """
        calibration = self.calibration
        if calibration is None:
            raise ArgumentError(
                f"{self.system}: this emulator has no error bounds. na.fit_error_bounds(emulator) measures them."
            )
        if level not in calibration.levels:
            levels = ", ".join(f"{known:g}" for known in calibration.levels)
            raise ArgumentError(f"level: wanted one of {levels}, got {level}.")
        if are_optimised and not calibration.knows_optimised:
            raise ArgumentError(
                f"are_optimised: {self.system} was measured under random controls alone, as it cannot be simulated."
            )
        _, scores = self.rollout_trusted(state, controls, may_diverge=True)
        return calibration.along(np.asarray(scores, float), level, KINDS[are_optimised])

    def covers(self, state: ArrayLike, control: ArrayLike) -> bool:
        """Return whether this emulator was trained on states like `state` (S,) with `control` (C,): `trust` is at most 1.

        Controls are covered between their bounds. Numbers that are not finite are never covered.

        Raises ArgumentError for wrong shapes.
        """
        is_known = bool(np.all(self.trust(state, control) <= EDGE))
        return is_known and self.bounds.contain(np.asarray(control, float))

    def save(self, path: str | Path) -> None:
        """Write the emulator as one `.safetensors` file."""
        artifact.save(self, Path(path))

    @classmethod
    def load(cls, path: str | Path) -> Emulator:
        """Return the emulator in the file at `path`, or the one that ships under the name `path`, such as "fish-50".

        A name has no folder and no suffix. Raises BadFileError with what is wrong with a file, and the list of names.
        """
        file = find_emulator(path) if isinstance(path, str) and is_name(path) else Path(path)
        return artifact.load(file, cls)

    def at(self, /, **values: float) -> Emulator:
        """Return the emulator of the body with the given parameters, stored in `rest`, where motions begin.

        `emulator.at(forearm_mass=1.3)`. Parameters are entries of the state, so a gradient in the state includes them.

        Raises ArgumentError for an unknown parameter, and for a value outside the range of training.
        """
        fixed_parameters(self.parameters, values)
        rest = start_state(self.state, self.spec.rest, values, cloud=self.state_structure.cloud)
        return replace(self, spec=replace(self.spec, rest=tuple(rest.tolist())))

    def in_strides(self, count: int) -> Emulator:
        """Return the emulator whose super step is `count` super steps of this one, its strides, under one control.

        It costs `count` times as much, and is more accurate than a single leap of that length wherever a shorter one is
        easier to learn: see `docs/decisions/0017-strides.md`.

        Raises ArgumentError for more strides than a file may have.
        """
        strides = self.strides * count
        if not 1 <= strides <= MAX_STRIDES:
            raise ArgumentError(f"count: wanted 1 to {MAX_STRIDES} strides in all, got {strides}.")
        spec = replace(
            self.spec, substeps=self.substeps * count, dt=self.dt * count, strides=strides
        )
        # Consecutive strides change the state in similar ways, so their changes add up.
        normaliser = replace(self.normaliser, unit=self.normaliser.unit * count)
        # Measurements of single strides do not hold for super steps.
        return replace(self, spec=spec, normaliser=normaliser, calibration=None, validation=None)

    def rest_streams(self) -> tuple[Float[Array, " O"], Float[Array, " E"]]:
        """Return the network's input at rest without control; left and right are equal there, to the last bit."""
        latent = np.asarray(self.encode(self.rest))
        control = np.asarray(self.encode_control(self.bounds.idle))
        raw = np.asarray(self.raw_features(latent, control))
        return _streams_at_rest(self, as_float32(latent), as_float32(raw))

    def at_rest(self, streams: tuple[Float[Array, " O"], Float[Array, " E"]]) -> Emulator:
        """Return the emulator that stays at rest: the network's answer to `rest_streams` is subtracted.

        Only for systems that stay at rest. It costs nothing: the mean change absorbs it.
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
    """Return the network's input for `latent` and its `raw` features, where left and right are equal."""
    plain = emulator.normaliser.forward(emulator.domain.clip(raw))
    odd, even = emulator.features.streams(latent, plain)
    if emulator.features.is_odd:
        odd = jnp.zeros_like(odd)
    return odd, even


def as_emulator(reference: Emulator | str | Path) -> Emulator:
    """Return an emulator unchanged; for the name of a file or a system, the emulator that verbs use for it."""
    if isinstance(reference, Emulator):
        return reference
    return Emulator.load(find_emulator(str(reference)))


def load_emulator(name: str | Path) -> Emulator:
    """Return the emulator that ships under `name`, such as "fish-50", or the one in the file of that name.

    Raises BadFileError with what is wrong with a file, and the list of names.
    """
    return Emulator.load(name)
