"""Garments worn by another body: its bones move the movers that are called alike."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from jaxtyping import Float
from numpy import ndarray

from neuroanimator.animation.clip import Clip, make_clip
from neuroanimator.animation.path_drive import movers_of, path_drive
from neuroanimator.animation.push_out import push_out
from neuroanimator.animation.recorded_path import paths_of_nodes
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.export.gltf.scene import glb_content
from neuroanimator.files.glb import parse_glb


class Worn(NamedTuple):
    """The motion of a garment."""

    clip: Clip
    """Its surface alone, outside of its wearer's capsules."""
    scores: Float[ndarray, " T"]
    """Score of each super step (`Emulator.trust`)."""
    remarks: tuple[str, ...]
    """What the emulator does not know of the wearer's motion, for the user."""


def wear(wearer: Clip, garment: Emulator) -> Worn:
    """Return how a garment follows its wearer, whose bones are called as its movers, as in his GLB file.

    Raises ArgumentError if none is.
    """
    file = parse_glb(glb_content(wearer))
    paths = paths_of_nodes(file, wearer.name, movers_of(garment))
    drive = path_drive(garment, paths)
    states, scores = drive.trusted_motion(garment)
    rate = 1 / (wearer.times[1] - wearer.times[0])
    clip = push_out(make_clip(garment, states, rate=rate, source="emulator"), garment)
    # The capsules stand for the wearer, who is drawn himself.
    bones = tuple(replace(bone, shapes=()) for bone in clip.skeleton.bones)
    clip = replace(clip, skeleton=replace(clip.skeleton, bones=bones))
    return Worn(clip, scores, drive.remarks)
