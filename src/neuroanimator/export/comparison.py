"""A replay as GLB: the physics with the emulator as a ghost, or the emulator alone where there is no physics."""

from __future__ import annotations

from pathlib import Path

from neuroanimator.animation.clip import Clip, make_clip
from neuroanimator.animation.gauges import drawable
from neuroanimator.control.synthesis.replay import Replay
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.export.gltf.scene import write_glb


def write_comparison(emulator: Emulator, replay: Replay, path: str | Path) -> None:
    """Write the motion on the true physics to `path` as GLB, with the emulator's as a ghost beside it.

    Where there is no physics, as with recordings, it is the emulator's motion alone.
    """
    clip, ghost = replay_clips(emulator, replay)
    write_glb(clip, path, ghost=ghost)


def replay_clips(emulator: Emulator, replay: Replay) -> tuple[Clip, Clip | None]:
    """Return (the motion on the physics, the emulator's as its ghost); where there is no physics, the latter alone."""
    emulated = make_clip(emulator, replay.emulator_states, source="emulator")
    if not replay.is_on_physics:
        return drawable(emulated, emulator), None
    return drawn_pair(
        make_clip(emulator, replay.physics_states, source="physics"), emulated, emulator
    )


def drawn_pair(physics: Clip, emulated: Clip, emulator: Emulator) -> tuple[Clip, Clip]:
    """Return (the motion on the physics, the emulator's as its ghost), as gauges where there are no bodies."""
    ghost = drawable(emulated, emulator, ranges_from=physics)
    return drawable(physics, emulator), ghost
