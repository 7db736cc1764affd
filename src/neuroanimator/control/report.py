"""What a synthesis achieved, as rows to print."""

from __future__ import annotations

from neuroanimator.control.synthesise import Synthesis


def outcome_rows(found: Synthesis) -> list[tuple[str, object]]:
    """Return names and values, the physics' verdict last."""
    descent, outcome = found.descent, found.outcome
    return [
        ("method", descent.method),
        ("iterations", descent.iterations),
        ("synthesis", f"{descent.seconds:.2f} s"),
        ("corrections by replay", found.corrections),
        ("refinements by training", found.refinements),
        ("physics steps taken", found.physics_steps),
        *([("gradient against the physics'", f"cosine {found.trust.cosine:.2f}")] if found.trust else []),
        ("J on emulator", f"{outcome.cost_emulator:.3f}"),
        ("J on physics", f"{outcome.cost_physics:.3f}"),
        ("gap", f"{outcome.gap:+.3f}"),
        *(
            [("goal reached on the true physics", "yes" if found.is_reached else "no")]
            if found.is_reached is not None
            else []
        ),
    ]


def warnings_of(found: Synthesis) -> list[str]:
    """Return what a user should know before relying on the controller, a line each."""
    diverged = "The descent diverged: J stopped being finite. The best controls before that are kept."
    lines = [diverged if found.descent.is_diverged else "", found.trust.warning() if found.trust else ""]
    return [line for line in lines if line]
