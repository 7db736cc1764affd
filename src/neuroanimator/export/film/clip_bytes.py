"""Clips as bytes, on their way from the process that has them to the one that draws them."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from neuroanimator.animation.clip import Clip
from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.export.film.options import Film, checked_film


def pack_clips(clips: Sequence[Clip], film: Film) -> bytes:
    """Return all that the drawing process needs, as the bytes of an .npz file."""
    rows = [
        {"name": clip.name, "definition": clip.definition, "skeleton": clip.skeleton.to_json()}
        for clip in clips
    ]
    description = {"size": list(film.size), "camera": film.camera, "clips": rows}
    arrays: dict[str, Any] = {"description": np.array(json.dumps(description))}
    for number, clip in enumerate(clips):
        arrays[f"times{number}"] = clip.times
        arrays[f"states{number}"] = clip.states
    content = io.BytesIO()
    np.savez(content, **arrays)
    return content.getvalue()


def unpack_clips(content: bytes) -> tuple[list[Clip], Film]:
    """Return what `pack_clips` was given."""
    arrays = np.load(io.BytesIO(content), allow_pickle=False)
    description = json.loads(str(arrays["description"]))
    clips = []
    for number, row in enumerate(description["clips"]):
        skeleton = Skeleton.from_json(row["skeleton"])
        times = arrays[f"times{number}"]
        states = arrays[f"states{number}"]
        clips.append(Clip(row["name"], skeleton, times, states, row["definition"]))
    width, height = description["size"]
    return clips, checked_film((width, height), description["camera"])
