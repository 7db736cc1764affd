"""What a film is cut together from: takes, each of its own clips before its own camera."""

from __future__ import annotations

from typing import NamedTuple

from neuroanimator.animation.clip import Clip


class Take(NamedTuple):
    """Clips that are seen together, until the longest of them ends."""

    clips: tuple[Clip, ...]
    ghost: Clip | None = None
    """Another motion of the first clip's body, translucent at the same place and time; the camera does not heed it."""
    caption: str = ""
    """A line below the picture; empty for none."""
    held: int = 0
    """Number of times its last image is shown again."""

    @property
    def frames(self) -> int:
        """How many images are drawn of it."""
        return max(len(clip.times) for clip in self.everything)

    @property
    def everything(self) -> tuple[Clip, ...]:
        """All clips, the ghost last."""
        if self.ghost is None:
            return self.clips
        return (*self.clips, self.ghost)
