"""A capsule as triangles."""

from __future__ import annotations

import numpy as np

AROUND, ALONG = 20, 12
"""Points around the axis and from pole to pole: smooth at arm's length, 240 points a capsule."""


def capsule_mesh(start: np.ndarray, end: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (points (N, 3), normals (N, 3), triangles (M, 3)) of the capsule from `start` to `end` [m]."""
    axis = (end - start) / np.linalg.norm(end - start)
    side = np.cross(axis, [1.0, 0.0, 0.0] if abs(axis[0]) < 0.9 else [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    latitudes = np.linspace(-np.pi / 2, np.pi / 2, ALONG)
    angles = np.linspace(0, 2 * np.pi, AROUND, endpoint=False)
    ring = np.cos(angles)[:, None] * side + np.sin(angles)[:, None] * np.cross(axis, side)
    normals = np.cos(latitudes)[:, None, None] * ring + np.sin(latitudes)[:, None, None] * axis
    centres = np.where((latitudes < 0)[:, None], start, end)
    points = centres[:, None] + radius * normals
    return _float32(points), _float32(normals), _triangles()


def _triangles() -> np.ndarray:
    low, next_ = np.arange(AROUND), np.roll(np.arange(AROUND), -1)
    bands = [
        np.concatenate([np.stack([low, next_, low + AROUND], 1), np.stack([next_, next_ + AROUND, low + AROUND], 1)])
        + band * AROUND
        for band in range(ALONG - 1)
    ]
    return np.concatenate(bands).astype(np.uint16)


def _float32(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values.reshape(-1, 3), dtype=np.float32)
