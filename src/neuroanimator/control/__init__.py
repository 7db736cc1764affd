"""Finding controls: parametrisations of descents, obstacles, and receding-horizon planning.

    from neuroanimator import control

    options = na.DescentOptions(parametrisation=control.Spline.of(steps, 16, system.bounds))

Cost terms and the search itself are names of `neuroanimator`.
"""

from __future__ import annotations

from neuroanimator.lazy import lazy_names

__getattr__, __dir__ = lazy_names(__name__)
