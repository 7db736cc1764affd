"""A replay as GLB: what the physics does, and the emulator's ghost."""

from __future__ import annotations

from pathlib import Path

from neuroanimator.animation.clip import make_clip
from neuroanimator.control.synthesis.replay import Replay
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.export.gltf.scene import write_glb


def write_comparison(emulator: Emulator, replay: Replay, path: str | Path) -> None:
    """Write the motion on the true physics to `path` as GLB, with the emulator's as a ghost beside it."""
    path = Path(path)
    physics_clip = make_clip(emulator, replay.physics_states, source="physics")
    emulator_clip = make_clip(emulator, replay.emulator_states, source="emulator")
    write_glb(physics_clip, path, ghost=emulator_clip)
