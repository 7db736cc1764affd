"""Motions as files to take along: written where nobody else can read, and fetched by a name nobody can guess."""

from __future__ import annotations

import secrets
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from neuroanimator import (
    ArgumentError,
    Clip,
    DivergedError,
    Emulator,
    make_clip,
    write_clip,
    write_glb,
    write_usd,
)
from neuroanimator.authoring import clip_of, drawable, folder_until_exit, write_whole
from neuroanimator_studio.drive import checked_drive, checked_states
from neuroanimator_studio.judge import replay_physics
from neuroanimator_studio.library import Shown
from neuroanimator_studio.limits import Limits
from neuroanimator_studio.requests import Export

MAX_OFF_UNIT = 0.1
"""Largest difference of a quaternion's length from one."""

ID_BYTES = 16
"""Random bytes of a download's id."""

MEDIA_TYPES = {
    "glb": "model/gltf-binary",
    "csv": "text/csv; charset=utf-8",
    "usda": "model/vnd.usda",
    "usdz": "model/vnd.usdz+zip",
    "html": "text/html; charset=utf-8",
}
"""What browsers are told of each format."""


@dataclass(frozen=True)
class Download:
    """A file to be fetched."""

    path: Path
    name: str
    """What it is to be called."""
    media_type: str


class Downloads:
    """Exported files, the latest of them, until the server ends."""

    def __init__(self, most: int):
        self._most = most
        self._folder = folder_until_exit()
        self._downloads: OrderedDict[str, Download] = OrderedDict()

    def write(self, shown: Shown, wanted: Export, limits: Limits) -> str:
        """Write a motion, and return the id it is fetched by; errors are those of the exporters."""
        download_id, path = self._new(wanted)
        write_motion(shown, wanted, limits, path)
        return self._keep(download_id, path, wanted)

    def keep(self, content: bytes, wanted: Export) -> str:
        """Keep a file that is made already, and return the id it is fetched by."""
        download_id, path = self._new(wanted)
        write_whole(path, content)
        return self._keep(download_id, path, wanted)

    def _new(self, wanted: Export) -> tuple[str, Path]:
        download_id = secrets.token_urlsafe(ID_BYTES)
        return download_id, self._folder / f"{download_id}.{wanted.format}"

    def _keep(self, download_id: str, path: Path, wanted: Export) -> str:
        name = f"{wanted.bundle}.{wanted.format}"
        self._downloads[download_id] = Download(path, name, MEDIA_TYPES[wanted.format])
        while len(self._downloads) > self._most:
            _, oldest = self._downloads.popitem(last=False)
            oldest.path.unlink(missing_ok=True)
        return download_id

    def find(self, download_id: str) -> Download | None:
        """Return the file with that id; None if there is none."""
        return self._downloads.get(download_id)


def write_motion(shown: Shown, wanted: Export, limits: Limits, path: Path) -> None:
    """Write what is shown to `path`, the physics beside it if wanted; a table has what is shown alone."""
    clip = _shown_clip(shown, wanted, limits)
    if wanted.format == "csv":
        write_clip(clip, path, shown.spec.state)
        return
    drawn = _drawable(shown, clip)
    ghost = None
    if wanted.ghost and clip.source == "emulator":
        ghost = _drawable(shown, _physics_clip(shown, wanted, limits))
    if wanted.format == "glb":
        write_glb(drawn, path, ghost=ghost)
    else:
        write_usd(drawn, path, ghost=ghost)


def described_drive(shown: Shown, wanted: Export, limits: Limits) -> dict[str, Any]:
    """Return a motion as the page reads it, checked; errors are those of `checked_drive`."""
    drive = checked_drive(shown.spec, wanted, limits)
    pushes = [[push.step, push.change.tolist()] for push in drive.pushes]
    return {
        "start": drive.start.tolist(),
        "controls": drive.controls.tolist(),
        "pushes": pushes,
    }


def _shown_clip(shown: Shown, wanted: Export, limits: Limits) -> Clip:
    """Return the motion as the page shows it: by the emulator, or by the physics."""
    emulator = shown.emulator
    if emulator is None or wanted.source == "physics":
        return _physics_clip(shown, wanted, limits)
    if wanted.states is not None:
        states = checked_states(shown.spec, wanted.states)
        _check_orientations(emulator, states)
    else:
        drive = checked_drive(shown.spec, wanted, limits)
        states = drive.played(
            lambda start, held: np.asarray(emulator.rollout(start, held, may_diverge=True), float)
        )
    if not np.isfinite(states).all():
        raise DivergedError(
            "The emulator's motion ends in numbers that are not finite. Shorten it."
        )
    return make_clip(emulator, states, rate=wanted.rate, source="emulator")


def _check_orientations(emulator: Emulator, states: Float[np.ndarray, "K S"]) -> None:
    """Refuse states that say no orientation where there must be one."""
    for entry, _ in emulator.state_structure.orientations:
        lengths = np.linalg.norm(states[:, entry : entry + 4], axis=1)
        if not (np.abs(lengths - 1) < MAX_OFF_UNIT).all():
            raise ArgumentError("states: wanted quaternions of length one.")


def _physics_clip(shown: Shown, wanted: Export, limits: Limits) -> Clip:
    drive = checked_drive(shown.spec, wanted, limits)
    replayed = replay_physics(shown, drive, limits)
    orientations = shown.system.structure.orientations
    return clip_of(shown.spec, orientations, replayed.states, rate=wanted.rate, source="physics")


def _drawable(shown: Shown, clip: Clip) -> Clip:
    """Return `clip`, or gauges of its numbers where there are no bodies to draw."""
    return clip if shown.emulator is None else drawable(clip, shown.emulator)
