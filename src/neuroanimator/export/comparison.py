"""A replay as GLB: what the physics does, and the emulator's ghost."""

from __future__ import annotations

from pathlib import Path

from neuroanimator.animation.clip import make_clip
from neuroanimator.control.synthesis.replay import Replay
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.export.gltf.scene import write_glb


def write_comparison(emulator: Emulator, proof: Replay, path: Path) -> None:
    """Write the motion on the true physics as GLB, with the emulator's as a ghost beside it."""
    physics_states = make_clip(emulator, proof.physics_states, source="physics")
    emulator_states = make_clip(emulator, proof.emulator_states, source="emulator")
    write_glb(physics_states, path, ghost=emulator_states)
