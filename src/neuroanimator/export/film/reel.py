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


def packed(clips: Sequence[Clip], film: Film) -> bytes:
    """Return all that the drawing process needs, as the bytes of an .npz file."""
    described = {
        "size": list(film.size),
        "camera": film.camera,
        "clips": [
            {"name": clip.name, "definition": clip.definition, "skeleton": clip.skeleton.to_json()}
            for clip in clips
        ],
    }
    arrays: dict[str, Any] = {"described": np.array(json.dumps(described))}
    for number, clip in enumerate(clips):
        arrays[f"times{number}"] = clip.times
        arrays[f"states{number}"] = clip.states
    content = io.BytesIO()
    np.savez(content, **arrays)
    return content.getvalue()


def unpacked(content: bytes) -> tuple[list[Clip], Film]:
    """Return what was `packed`."""
    arrays = np.load(io.BytesIO(content), allow_pickle=False)
    described = json.loads(str(arrays["described"]))
    clips = []
    for number, row in enumerate(described["clips"]):
        skeleton = Skeleton.from_json(row["skeleton"])
        times, states = arrays[f"times{number}"], arrays[f"states{number}"]
        clips.append(Clip(row["name"], skeleton, times, states, row["definition"]))
    width, height = described["size"]
    return clips, checked_film((width, height), described["camera"])
