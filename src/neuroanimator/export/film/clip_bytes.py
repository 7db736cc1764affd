"""Clips as bytes, on their way from the process that has them to the one that draws them."""

from __future__ import annotations

import io
import json
import pickle
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import UInt8

from neuroanimator.animation.clip import Clip
from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.export.film.options import Film, checked_film
from neuroanimator.export.film.takes import Take


def pack_files(definitions: Iterable[str]) -> UInt8[np.ndarray, " N"]:
    """Return the files of the user's that systems with these definitions are drawn from, for the drawing process."""
    own = [definition for definition in definitions if definition]
    if not own:
        return np.zeros(0, np.uint8)
    # What ships has no definition, and needs no physics here.
    from neuroanimator.systems.loading import named_model
    from neuroanimator.systems.trusted_files import trusted_so_far

    for definition in own:
        named_model(definition)
    return np.frombuffer(pickle.dumps(trusted_so_far()), np.uint8)


def use_files(packed: UInt8[np.ndarray, " N"]) -> None:
    """Let this process, the drawing one, use the files `pack_files` was given."""
    if packed.size:
        from neuroanimator.systems.trusted_files import trust_as_told

        trust_as_told(pickle.loads(packed.tobytes()))


def pack_takes(takes: Sequence[Take], film: Film) -> bytes:
    """Return all that the drawing process needs, as the bytes of an .npz file."""
    arrays: dict[str, Any] = {}
    rows = []
    for number, take in enumerate(takes):
        clips = []
        for place, clip in enumerate(take.everything):
            clips.append(
                {
                    "name": clip.name,
                    "definition": clip.definition,
                    "skeleton": clip.skeleton.to_json(),
                    "verdict": clip.verdict,
                }
            )
            arrays[f"times {number} {place}"] = clip.times
            arrays[f"states {number} {place}"] = clip.states
            if clip.trust is not None:
                arrays[f"trust {number} {place}"] = clip.trust
        has_ghost = take.ghost is not None
        rows.append(
            {"clips": clips, "has_ghost": has_ghost, "caption": take.caption, "held": take.held}
        )
    description = {
        "size": list(film.size),
        "camera": film.camera,
        "is_quick": film.is_quick,
        "takes": rows,
    }
    arrays["description"] = np.array(json.dumps(description))
    arrays["files"] = pack_files({take.clips[0].definition for take in takes})
    content = io.BytesIO()
    np.savez(content, **arrays)
    return content.getvalue()


def unpack_takes(content: bytes) -> tuple[list[Take], Film]:
    """Return what `pack_takes` was given."""
    arrays = np.load(io.BytesIO(content), allow_pickle=False)
    use_files(arrays["files"])
    description = json.loads(str(arrays["description"]))
    takes = []
    for number, row in enumerate(description["takes"]):
        clips = []
        for place, described in enumerate(row["clips"]):
            skeleton = Skeleton.from_json(described["skeleton"])
            times = arrays[f"times {number} {place}"]
            states = arrays[f"states {number} {place}"]
            clip = Clip(described["name"], skeleton, times, states, described["definition"])
            if f"trust {number} {place}" in arrays:
                trust = arrays[f"trust {number} {place}"]
                clip = replace(clip, trust=trust, verdict=described["verdict"])
            clips.append(clip)
        ghost = clips.pop() if row["has_ghost"] else None
        takes.append(Take(tuple(clips), ghost, row["caption"], row["held"]))
    width, height = description["size"]
    film = checked_film((width, height), description["camera"], is_quick=description["is_quick"])
    return takes, film
