"""A replay as GLB: what the physics does, and the emulator's ghost."""

from __future__ import annotations

from pathlib import Path

from neuroanimator.animation.clip import make_clip
from neuroanimator.control.synthesis.replay import Replay
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.export.gltf.scene import write_glb


def write_proof(emulator: Emulator, proof: Replay, path: Path) -> None:
    """Write the motion on the true physics as GLB, with the emulator's as a ghost beside it."""
    physical = make_clip(emulator, proof.physical, source="physics")
    emulated = make_clip(emulator, proof.emulated, source="emulator")
    write_glb(physical, path, ghost=emulated)
