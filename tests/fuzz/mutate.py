"""JSON changed as JSON: bytes changed at random seldom get past its reader."""

from __future__ import annotations

import json
import random
from typing import Any

ODD: tuple[Any, ...] = (
    None, True, -1, 0, 1, 2, 7, 2**31, 2**63, 10**30, -0.0, 0.5, 1e-300, 1e300, "", "a", "a\n\x1b[1m", "é\u2028",
    [], {}, [[]], [1, [2]], [-1], [None], {"a": 1}, [0] * 50, "9" * 50,
)  # fmt: skip
"""Values nobody expects."""


def changed_json(content: bytes, seed: int) -> bytes | None:
    """Return the JSON in `content` with one value replaced, doubled or left out; None if it is no JSON."""
    try:
        value = json.loads(content)
    except (ValueError, RecursionError):
        return None
    rng = random.Random(seed)
    root = [value]
    positions = _places(root)
    parent, key = rng.choice(positions)
    way = rng.randrange(4)
    if way == 0 and parent is not root:
        del parent[key]
    elif way == 1 and isinstance(parent, list):
        parent.append(parent[key])
    elif way == 2:
        other, name = rng.choice(positions)
        parent[key] = json.loads(json.dumps(other[name]))
    else:
        parent[key] = rng.choice(ODD)
    return json.dumps(root[0]).encode()


def _places(root: list[Any]) -> list[tuple[Any, Any]]:
    """Return (list or object, index or name) of every value inside `root`."""
    found: list[tuple[Any, Any]] = []
    waiting: list[Any] = [root]
    while waiting:
        parent = waiting.pop()
        keys = range(len(parent)) if isinstance(parent, list) else list(parent)
        for key in keys:
            found.append((parent, key))
            if isinstance(parent[key], list | dict):
                waiting.append(parent[key])
    return found
