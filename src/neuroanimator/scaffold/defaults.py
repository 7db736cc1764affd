"""What every proposed definition aims for, whoever steps the system."""

from __future__ import annotations

WANTED_SUPER_STEP = 0.1
"""[s] A super step proposed is at most about this long, and never less than one step: three pictures of a film."""

GOOD_ENOUGH = 0.002
"""One-step error at which a scheme may teach, over the change's standard deviation."""

WHOLE_TURN = 3.1416
"""[rad] Half the width of a spread over all angles."""


def proposed_substeps(step: float) -> int:
    """Return how many steps of `step` [s] a super step should have."""
    return max(1, round(WANTED_SUPER_STEP / step))
