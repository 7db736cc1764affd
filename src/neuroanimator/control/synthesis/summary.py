"""Results of a synthesis, as rows to print."""

from __future__ import annotations

import math

from neuroanimator.control.synthesis.attempt import SearchCost
from neuroanimator.control.synthesis.replay import is_gap_large
from neuroanimator.control.synthesis.synthesise import Synthesis
from neuroanimator.emulator.trust_summary import TrustSummary, summary_of
from neuroanimator.terminal import Rows

MINUTES_SPARE = 2.0
"""Multiple of the estimated time that is enough: unrolled updates take longer than those timed."""

SMALL_GAP = 0.05
"""Relative difference up to which two values of J are called equal."""

UNPROVED = "not verified: this controller was tried on the emulator alone. Use it with care"
"""Text for a controller that was tried on the emulator alone."""


def outcome_rows(synthesis: Synthesis) -> Rows:
    """Return names and values, the physics' verdict last."""
    outcome = synthesis.outcome
    spent = synthesis.spent
    rows: Rows = [
        ("method", synthesis.descent.method),
        ("iterations", spent.iterations),
        ("descents, compiling not counted", f"{spent.seconds:.2f} s"),
    ]
    if not outcome.is_on_physics:
        return rows + _unproved_rows(synthesis)
    rows += [
        ("corrections by replay", spent.corrections),
        ("refinements by training", _refinements_in_words(spent)),
        ("physics steps taken", spent.physics_steps),
    ]
    if synthesis.trust is not None:
        rows.append(("gradient against the physics'", f"cosine {synthesis.trust.cosine:.2f}"))
    words = gap_in_words(
        outcome.cost_emulator,
        outcome.cost_physics,
        synthesis.is_reached,
        is_corrected=spent.corrections > 0,
    )
    rows += [
        ("J on emulator", f"{outcome.cost_emulator:.3f}"),
        ("J on physics", f"{outcome.cost_physics:.3f}"),
        ("gap", f"{outcome.gap:+.3f}"),
        ("in words", words),
    ]
    trust = str(trust_along(synthesis))
    if outcome.fault:
        trust += "; yet the replay shows that it is wrong about this motion"
    rows.append(("trust in the emulator's motion", trust))
    return rows + _goal_rows(synthesis, "goal reached on the true physics")


def _goal_rows(synthesis: Synthesis, name: str) -> Rows:
    """Return a row called `name` on whether the goal is reached; none without a goal."""
    if synthesis.is_reached is None:
        return []
    return [(name, "yes" if synthesis.is_reached else "no")]


def _refinements_in_words(spent: SearchCost) -> str:
    """Return how many times the emulator learnt the physics around a motion, and how to allow a training given up."""
    if not spent.minutes_wanted:
        return str(spent.refinements)
    return f"{spent.refinements}; another one would have taken too long: --minutes {_enough_minutes(spent)} allows it"


def _enough_minutes(spent: SearchCost) -> int:
    """Return the whole minutes that the refinement that was given up needs."""
    return math.ceil(MINUTES_SPARE * spent.minutes_wanted)


def _unproved_rows(synthesis: Synthesis) -> Rows:
    """Return names and values of results on the emulator alone, the goal last."""
    rows: Rows = [
        ("J on emulator", f"{synthesis.outcome.cost_emulator:.3f}"),
        ("trust in the emulator's motion", trust_along(synthesis)),
        ("in words", UNPROVED),
    ]
    return rows + _goal_rows(synthesis, "goal reached on the emulator, which verifies nothing")


def trust_along(synthesis: Synthesis) -> TrustSummary:
    """Return the summary of trust in the emulator's motion under the controls found."""
    emulator = synthesis.emulator
    start = synthesis.outcome.emulator_states[0]
    _, scores = emulator.rollout_trusted(start, synthesis.controls, may_diverge=True)
    return summary_of(emulator, scores)


def gap_in_words(
    cost_emulator: float,
    cost_physics: float,
    is_reached: bool | None = None,
    *,
    is_corrected: bool = False,
) -> str:
    """Return the meaning of J of a controller in words, as predicted by the emulator and on the physics.

    Controls that replays corrected fit the physics: the emulator then only tells how far off it is about them.
    """
    meaning = "J adds up how far the motion is from what was asked for, so lower is better; "
    is_missed = is_reached is False
    if is_missed:
        meaning += "the goal is missed: "
    gap = cost_physics - cost_emulator
    if abs(gap) <= SMALL_GAP * max(cost_emulator, cost_physics):
        if is_missed:
            return meaning + "the emulator predicted as high a J"
        return meaning + "the physics does what the emulator predicted"
    if gap < 0 and is_corrected:
        return (
            meaning
            + "replays on the physics repaired the motion, about which the emulator is off: trust the physics' J"
        )
    if gap < 0:
        return meaning + "the emulator predicted a worse motion than the physics does"
    if is_gap_large(cost_emulator, cost_physics):
        return (
            meaning
            + "the physics does much worse than the emulator predicted: trust the physics' J"
        )
    return meaning + "the physics does a little worse than the emulator predicted"


def _remedy(synthesis: Synthesis, improve: str) -> str:
    """Return what to do about an emulator that is wrong about the motion found; `improve` is the command for it."""
    if synthesis.spent.minutes_wanted:
        return f"Let it learn the physics around the motion: --minutes {_enough_minutes(synthesis.spent)}."
    if synthesis.outcome.gap < 0:
        return f"The controls are the physics' best; to let the emulator learn the physics around them: {improve}"
    return f"Let it learn the physics around these controls, then search again: {improve}"


def warnings_of(synthesis: Synthesis, improve: str) -> list[str]:
    """Return warnings for a user who relies on the controller, a line each.

    `improve` is the command that makes the emulator learn around the controls found.
    """
    lines = []
    if synthesis.descent.is_diverged:
        lines.append(
            "The descent diverged: J stopped being finite. The best controls before that are kept."
        )
    fault = synthesis.outcome.fault
    if fault:
        lines.append(f"{fault}. {_remedy(synthesis, improve)}")
    if synthesis.trust is not None:
        lines.append(synthesis.trust.warning())
    return [line for line in lines if line]
