"""Pieces of a body: nodes that its springs or elements connect, for any physics."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int


def pieces_of(count: int, elements: Int[np.ndarray, "E K"]) -> Int[np.ndarray, " N"]:
    """Return the number of the piece each of `count` nodes belongs to, in the order of their first nodes."""
    # Imported here, as in `recorded.velocities`: every system's loading would wait for it.
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    first = np.repeat(elements[:, 0], elements.shape[1] - 1)
    ends = (first, elements[:, 1:].ravel())
    links = coo_array((np.ones(len(first)), ends), shape=(count, count))
    return connected_components(links, directed=False)[1]
