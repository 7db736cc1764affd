"""What a synthesis achieved, as rows to print and as a GLB to look at."""

from __future__ import annotations

from pathlib import Path

from neuroanimator.animation.clip import make_clip
from neuroanimator.control.replay import Replay
from neuroanimator.control.synthesise import Synthesis
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.export.gltf import write_glb


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


def write_proof(emulator: Emulator, proof: Replay, path: Path) -> None:
    """Write the motion on the true physics as GLB, with the emulator's as a ghost beside it."""
    physical, emulated = (make_clip(emulator, states) for states in (proof.physical, proof.emulated))
    write_glb(physical, path, ghost=emulated)
