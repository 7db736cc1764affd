"""Parametrisations: the numbers z that a descent varies, and the controls within bounds that they give."""

from __future__ import annotations

import abc
import math

import equinox as eqx
import numpy as np
from jaxtyping import Float

from neuroanimator.emulator.arrays import as_parameter
from neuroanimator.errors import ArgumentError
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.gait import Gait
from neuroanimator.state.layout import Bounds

NEARLY_ALL = 0.999
"""Share of the bounds to which initial guesses are clipped: z is infinite at the bounds."""

FASTEST = 2.0
"""Maximum ratio of a pattern's frequency to its initial one."""

SLOWEST = 0.5
"""Minimum ratio of a pattern's frequency to its initial one."""

CUBIC = 3
"""Degree of the splines."""


class Parametrisation(eqx.Module):
    """z (Z,) → controls (T, C) = middle + half · tanh(...): within bounds by construction."""

    middle: Float[AnyArray, " C"]
    half: Float[AnyArray, " C"]
    steps: int = eqx.field(static=True)

    @property
    @abc.abstractmethod
    def size(self) -> int:
        """Length of z."""

    @abc.abstractmethod
    def controls(self, z: Float[AnyArray, " Z"]) -> Float[AnyArray, "T C"]:
        """Return the controls of `z`."""

    @abc.abstractmethod
    def guess(self, controls: np.ndarray | None) -> np.ndarray:
        """Return the z (Z,) whose controls are closest to `controls` (T, C), or to the middle of the bounds for None."""


class EachStep(Parametrisation):
    """One value per super step and control."""

    @classmethod
    def of(cls, steps: int, bounds: Bounds) -> EachStep:
        """Return the parametrisation of a motion of `steps` super steps."""
        return cls(*_bounds(bounds), steps)

    @property
    def size(self) -> int:
        return self.steps * len(self.middle)

    def controls(self, z: Float[AnyArray, " Z"]) -> Float[AnyArray, "T C"]:
        return self.middle + _tanh(z.reshape(self.steps, -1)) * self.half

    def guess(self, controls: np.ndarray | None) -> np.ndarray:
        return _raw(self, controls).ravel()


class Spline(Parametrisation):
    """A clamped cubic spline per control: smooth, and fewer numbers than super steps."""

    basis: Float[AnyArray, "T K"]

    @classmethod
    def of(cls, steps: int, knots: int, bounds: Bounds) -> Spline:
        """Return the parametrisation by splines with `knots` knots over `steps` super steps."""
        # Imported here: it takes a quarter of a second, and most descents do not need it.
        from scipy.interpolate import BSpline

        if not 4 <= knots <= steps:
            raise ArgumentError(
                f"knots: wanted between 4 and the {steps} super steps, got {knots}."
            )
        inner = np.linspace(0, 1, knots - 2)
        knot_times = np.concatenate([[0.0] * CUBIC, inner, [1.0] * CUBIC])
        times = (np.arange(steps) + 0.5) / steps
        basis = BSpline.design_matrix(times, knot_times, CUBIC).toarray()
        return cls(*_bounds(bounds), steps, as_parameter(basis))

    @property
    def size(self) -> int:
        return self.basis.shape[1] * len(self.middle)

    def controls(self, z: Float[AnyArray, " Z"]) -> Float[AnyArray, "T C"]:
        return self.middle + _tanh(self.basis @ z.reshape(self.basis.shape[1], -1)) * self.half

    def guess(self, controls: np.ndarray | None) -> np.ndarray:
        basis = np.asarray(self.basis, float)
        return _least_squares(basis, _raw(self, controls)).ravel()


WIDEST_TEMPO = 3.0
"""Maximum magnitude of the frequency's number that a guess tries: nearly the slowest and the fastest."""

TEMPOS = 24
"""Number of frequencies tried in each round of a guess."""

TEMPO_ROUNDS = 4
"""Number of rounds, each around the best of the previous one."""

MISFIT_DIGITS = 9
"""Number of digits of the misfit of a wave: more would be rounding."""

TINY = 1e-12
"""Offset added to the squares of controls: idle ones fit any wave."""


class Periodic(Parametrisation):
    """A periodic pattern like animals' gaits: per control an offset and a wave, all of one frequency.

    z holds the frequency, then for each control offset, sine and cosine of the wave: amplitude and phase.
    """

    period: Float[AnyArray, ""]
    """Period of the initial guess [s]."""
    dt: float = eqx.field(static=True)

    @classmethod
    def of(cls, steps: int, dt: float, period: float, bounds: Bounds) -> Periodic:
        """Return the parametrisation by patterns whose frequency is near that of `period` [s]."""
        if not 2 * dt < period < np.inf:
            raise ArgumentError(
                f"period: wanted more than two super steps of {dt:g} s, got {period:g} s."
            )
        return cls(*_bounds(bounds), steps, as_parameter(period), dt)

    @property
    def size(self) -> int:
        return 1 + 3 * len(self.middle)

    def controls(self, z: Float[AnyArray, " Z"]) -> Float[AnyArray, "T C"]:
        return self.middle + _tanh(self.waves(z[0]) @ z[1:].reshape(3, -1)) * self.half

    def waves(self, number: Float[AnyArray, " *K"]) -> Float[AnyArray, "*K T 3"]:
        """Return 1, sine and cosine at each super step's middle, for the `number` that gives the frequency."""
        xp = number.__array_namespace__()
        rate = 2 * math.pi * self._tempo(number) / self.period
        phases = rate[..., None] * (xp.arange(self.steps) + 0.5) * self.dt
        return xp.stack([xp.ones_like(phases), xp.sin(phases), xp.cos(phases)], axis=-1)

    def _tempo(self, number: Float[AnyArray, " *K"]) -> Float[AnyArray, " *K"]:
        """Return the ratio to the initial frequency: 1 for a number of zero."""
        xp = number.__array_namespace__()
        return SLOWEST + (FASTEST - SLOWEST) / (1 + (FASTEST - 1) / (1 - SLOWEST) * xp.exp(-number))

    def guess(self, controls: np.ndarray | None) -> np.ndarray:
        raw = _raw(self, controls)
        number = 0.0
        width = WIDEST_TEMPO
        for _ in range(TEMPO_ROUNDS):
            # The middle comes first, and stays if no other is better.
            numbers = number + width * np.concatenate([[0.0], np.linspace(-1, 1, TEMPOS)])
            number = float(numbers[np.argmin(self._misfits(numbers, raw))])
            width *= 2 / TEMPOS
        weights = _least_squares(self.waves(np.array(number)), raw)
        return np.concatenate([[number], weights.ravel()])

    def _misfits(
        self, numbers: Float[np.ndarray, " K"], raw: Float[np.ndarray, "T C"]
    ) -> Float[np.ndarray, " K"]:
        """Return the share of the squares of `raw` that waves of each frequency do not fit; rounding counts as zero."""
        waves = np.asarray(self.waves(numbers))
        products = waves.mT @ raw
        met = np.sum(products * np.linalg.solve(waves.mT @ waves, products), axis=(1, 2))
        return np.round(1 - met / (np.sum(raw**2) + TINY), MISFIT_DIGITS)

    def gait(self, z: np.ndarray) -> Gait:
        """Return the pattern of z as a gait of controls that idle in their middle, without offsets and saturation."""
        sine, cosine = np.asarray(z[1:], float).reshape(3, -1)[1:]
        heights = np.tanh(np.hypot(sine, cosine))
        period = float(self.period / self._tempo(np.asarray(z[0])))
        phases = -np.arctan2(cosine, sine)
        return Gait(period, tuple(map(float, heights)), tuple(map(float, phases)))


class Steered(Parametrisation):
    """A pattern as in `Periodic` with offsets that change slowly, by splines: to swim, and to turn and leap meanwhile.

    z holds the frequency, then for each control sine and cosine of the wave, then the splines' knots (K, C).
    """

    wave: Periodic
    offsets: Spline

    @classmethod
    def of(cls, steps: int, dt: float, period: float, knots: int, bounds: Bounds) -> Steered:
        """Return the parametrisation by patterns near `period` [s], steered by splines with `knots` knots."""
        wave = Periodic.of(steps, dt, period, bounds)
        return cls(wave.middle, wave.half, steps, wave, Spline.of(steps, knots, bounds))

    @property
    def size(self) -> int:
        return 1 + 2 * len(self.middle) + self.offsets.size

    def controls(self, z: Float[AnyArray, " Z"]) -> Float[AnyArray, "T C"]:
        size = 1 + 2 * len(self.middle)
        knots = z[size:].reshape(self.offsets.basis.shape[1], -1)
        weights = z[1:size].reshape(2, -1)
        raw = self.offsets.basis @ knots + self.wave.waves(z[0])[:, 1:] @ weights
        return self.middle + _tanh(raw) * self.half

    def guess(self, controls: np.ndarray | None) -> np.ndarray:
        waves = np.asarray(self.wave.waves(np.zeros(())), float)
        columns = np.concatenate([waves[:, 1:], np.asarray(self.offsets.basis, float)], axis=1)
        weights = _least_squares(columns, _raw(self, controls))
        return np.concatenate([[0.0], weights.ravel()])


def _bounds(bounds: Bounds) -> tuple[Float[AnyArray, " C"], Float[AnyArray, " C"]]:
    low = np.array(bounds.low)
    high = np.array(bounds.high)
    is_sound = (low < high) & np.isfinite(low) & np.isfinite(high)
    if not is_sound.all():
        entry = int(np.argmin(is_sound))
        raise ArgumentError(
            f"bounds: wanted finite ones with low below high, control {entry} has {low[entry]:g} and {high[entry]:g}."
        )
    return as_parameter(bounds.middle), as_parameter(bounds.half)


def _tanh(numbers: Float[AnyArray, " ..."]) -> Float[AnyArray, " ..."]:
    return numbers.__array_namespace__().tanh(numbers)


def _raw(parametrisation: Parametrisation, controls: np.ndarray | None) -> np.ndarray:
    """Return the numbers (T, C) whose tanh gives `controls`; zeros, the middle of the bounds, for None."""
    middle = np.asarray(parametrisation.middle)
    if controls is None:
        return np.zeros((parametrisation.steps, len(middle)))
    share = (np.asarray(controls) - middle) / np.asarray(parametrisation.half)
    return np.arctanh(np.clip(share, -NEARLY_ALL, NEARLY_ALL))


def _least_squares(
    columns: Float[np.ndarray, "T K"], values: Float[np.ndarray, "T C"]
) -> Float[np.ndarray, "K C"]:
    """Return the weights of `columns` that best fit `values`."""
    weights, *_ = np.linalg.lstsq(columns, values, rcond=None)
    return weights
