"""What a synthesis achieved, as rows to print."""

from __future__ import annotations

from neuroanimator.control.synthesis.synthesise import Synthesis, is_gap_large

SMALL_GAP = 0.05
"""Share of J by which two values of it may differ and still be called the same."""


def outcome_rows(found: Synthesis) -> list[tuple[str, object]]:
    """Return names and values, the physics' verdict last."""
    descent, outcome = found.descent, found.outcome
    return [
        ("method", descent.method),
        ("iterations", descent.iterations),
        ("descents, compiling not counted", f"{descent.seconds:.2f} s"),
        ("corrections by replay", found.corrections),
        ("refinements by training", found.refinements),
        ("physics steps taken", found.physics_steps),
        *(
            [("gradient against the physics'", f"cosine {found.trust.cosine:.2f}")]
            if found.trust
            else []
        ),
        ("J on emulator", f"{outcome.cost_emulator:.3f}"),
        ("J on physics", f"{outcome.cost_physics:.3f}"),
        ("gap", f"{outcome.gap:+.3f}"),
        ("in words", gap_in_words(outcome.cost_emulator, outcome.cost_physics)),
        *(
            [("goal reached on the true physics", "yes" if found.is_reached else "no")]
            if found.is_reached is not None
            else []
        ),
    ]


def gap_in_words(cost_emulator: float, cost_physics: float) -> str:
    """Return what J says of a controller: how far it is from what was wished, foretold and on the physics."""
    meaning = "J adds up how far the motion is from what was asked for, so lower is better; "
    gap = cost_physics - cost_emulator
    if abs(gap) <= SMALL_GAP * max(cost_emulator, cost_physics):
        return meaning + "the physics does what the emulator foretold"
    if gap < 0:
        return meaning + "the physics does even better than the emulator foretold"
    if is_gap_large(cost_emulator, cost_physics):
        return (
            meaning + "the physics does much worse than the emulator foretold: trust the physics' J"
        )
    return meaning + "the physics does a little worse than the emulator foretold"


def warnings_of(found: Synthesis) -> list[str]:
    """Return what a user should know before relying on the controller, a line each."""
    diverged = (
        "The descent diverged: J stopped being finite. The best controls before that are kept."
    )
    lines = [
        diverged if found.descent.is_diverged else "",
        found.trust.warning() if found.trust else "",
    ]
    return [line for line in lines if line]
