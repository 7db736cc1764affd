"""Clips: timed states at the display rate, ready to draw or export."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from neuroanimator.animation.interpolate import INTERPOLATIONS
from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.spec import EmulatorSpec
from neuroanimator.errors import ArgumentError
from neuroanimator.state.layout import Pairs
from neuroanimator.state.slowness import slowness

USUAL_RATE = 30.0
"""Default display rate [1/s]."""

MAX_RATE = 1000.0
"""Maximum display rate [1/s]; no display and no engine asks for more."""

MAX_CLIPS = 1000
"""Maximum number of clips in one file."""

FRAME_ROUNDING = 1e-6
"""Share of a frame by which a motion may fall short of its last frame: floating-point rounding."""

STEP_ROUNDING = 1e-6
"""Share of a super step by which a frame may precede it and still belong to it: floating-point rounding."""

TIME_ROUNDING = 1e-9
"""Time by which the last frame may lie beyond the motion's end [s]."""


@dataclass(frozen=True)
class Clip:
    """A motion ready to draw or export."""

    name: str
    """The system's name."""
    skeleton: Skeleton
    times: Float[np.ndarray, " F"]
    """Time of each frame, evenly spaced from 0 [s]."""
    states: Float[np.ndarray, "F S"]
    """The state in each frame, in the system's own layout."""
    definition: str = ""
    """The definition of a user's own system; see `System.definition_text`."""
    source: str = ""
    """Origin of the motion, as exports state it: 'emulator', 'physics' or 'hybrid'; empty if not known."""
    trust: Float[np.ndarray, " F"] | None = None
    """Score (`Emulator.trust`) of the super step that each frame lies in, if films are to show it; else None."""
    verdict: str = ""
    """Verdict of `Emulator.verdict`, if films are to show the scores; empty if not known."""

    def __repr__(self) -> str:
        return f'Clip("{self.name}", {len(self.times)} frames, {self.times[-1]:.2f} s)'

    @property
    def rate(self) -> float:
        """Frames a second."""
        return (len(self.times) - 1) / float(self.times[-1])


def check_drawable(clip: Clip) -> None:
    """Raise ArgumentError for a clip without bodies to draw, such as one of a step function or of recordings."""
    if not clip.skeleton.bones:
        raise ArgumentError(
            f"clip: {clip.name} has no bodies to draw, only numbers. Draw na.as_gauges(clip, emulator) instead."
        )


def together(clips: Clip | Sequence[Clip], ghost: Clip | None) -> list[Clip]:
    """Return the clips that go into one file; ArgumentError if they cannot, or if the `ghost` shows another body."""
    every = [clips] if isinstance(clips, Clip) else list(clips)
    if not 1 <= len(every) <= MAX_CLIPS:
        raise ArgumentError(f"clips: wanted 1 to {MAX_CLIPS} in one file, got {len(every)}.")
    for clip in every:
        check_drawable(clip)
    if ghost is not None and (len(every) > 1 or ghost.skeleton != every[0].skeleton):
        names = " and ".join(clip.name for clip in every[:3])
        raise ArgumentError(
            f"ghost: wanted another motion of the same body, got {ghost.name} for {names}."
        )
    return every


def make_clip(
    emulator: Emulator,
    states: ArrayLike,
    *,
    rate: float | None = None,
    interpolation: str = "hermite",
    source: str = "",
    trust: ArrayLike | None = None,
) -> Clip:
    """Return the clip of a trajectory `states` (T+1, S) at `rate` frames a second; `source` says what made it.

    The default rate is 30; slow systems get 30 frames in the time that corresponds to a second for them. With `trust`
    (T,), the scores of the super steps, films show them.

    Raises ArgumentError for an unknown interpolation, a rate out of range, and states or scores of the wrong shape.
    """
    if interpolation not in INTERPOLATIONS:
        raise ArgumentError(
            f"No interpolation called '{interpolation}'. Interpolations: {', '.join(sorted(INTERPOLATIONS))}."
        )
    orientations = emulator.state_structure.orientations
    clip = clip_of(emulator.spec, orientations, states, rate, interpolation, source)
    if trust is None:
        return clip
    scores = np.asarray(trust, float)
    count = len(np.asarray(states)) - 1
    if scores.shape != (count,):
        raise ArgumentError(
            f"trust: wanted a score for each of {count} super steps, got {scores.shape}."
        )
    steps = np.minimum(clip.times / emulator.dt + STEP_ROUNDING, count - 1).astype(int)
    verdict = emulator.verdict
    return replace(clip, trust=scores[steps], verdict=verdict.word if verdict else "")


def clip_of(
    spec: EmulatorSpec,
    orientations: Pairs,
    states: ArrayLike,
    rate: float | None = None,
    interpolation: str = "hermite",
    source: str = "",
) -> Clip:
    """Return the clip that `make_clip` makes, from an emulator's spec and the `orientations` in its state."""
    trajectory = spec.state.check(states, "state")
    if rate is None:
        rate = USUAL_RATE / slowness(spec.dt)
    if not 0 < rate <= MAX_RATE:
        raise ArgumentError(f"rate: wanted between 0 and {MAX_RATE:g} frames a second, got {rate}.")
    times = _frame_times((len(trajectory) - 1) * spec.dt, rate)
    interpolate = INTERPOLATIONS[interpolation]
    frames = interpolate(trajectory, spec.dt, times, spec.rates, orientations)
    return Clip(spec.system, spec.skeleton, times, frames, spec.definition, source)


def _frame_times(duration: float, rate: float) -> Float[np.ndarray, " F"]:
    """Return the times of a motion's frames [s]; only its two ends if it is shorter than a frame."""
    count = max(1, int(duration * rate + FRAME_ROUNDING))
    if count == 1:
        return np.array([0.0, duration])
    times = np.arange(count + 1) / rate
    return times[times <= duration + TIME_ROUNDING]
