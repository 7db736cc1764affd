"""Write a clip in the format its file name asks for."""

from __future__ import annotations

from pathlib import Path

from neuroanimator.animation.clip import Clip
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.export.gltf import write_glb
from neuroanimator.export.table import write_clip
from neuroanimator.export.video import write_video
from neuroanimator.systems.skeleton import Skeleton

FORMATS = (".csv", ".glb", ".mp4")


def export_clip(clip: Clip, emulator: Emulator, path: Path) -> None:
    """Write `clip` to `path` as .csv, .glb or .mp4."""
    check_format(path)
    check_bodies(clip.skeleton, path)
    if path.suffix == ".glb":
        write_glb(clip, path)
    elif path.suffix == ".mp4":
        write_video(clip, path)
    else:
        write_clip(clip, path, emulator.identity.state)


def check_format(path: Path) -> None:
    """Refuse a file name with another ending, before any work is done for it."""
    if path.suffix not in FORMATS:
        raise ArgumentError(f"out: '{path.name}' ends in none of {', '.join(FORMATS)}.")


def check_bodies(skeleton: Skeleton, path: Path) -> None:
    """Refuse to draw a system that has no bodies: a step function or recordings."""
    if not skeleton.bones and path.suffix != ".csv":
        raise ArgumentError(f"out: {path.name} shows bodies, and this system has none, only numbers. Use .csv.")
