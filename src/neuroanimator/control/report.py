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
        ("J on emulator", f"{outcome.cost_emulator:.3f}"),
        ("J on physics", f"{outcome.cost_physics:.3f}"),
        ("gap", f"{outcome.gap:+.3f}"),
        *(
            [("goal reached on the true physics", "yes" if found.is_reached else "no")]
            if found.is_reached is not None
            else []
        ),
    ]
