"""Port of a sensor kind whose frames can be separated into the target's part and other things."""

from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from rpod_pose.surroundings.separation import RangeImage
from rpod_schemas.types import Float32Array, SensorFrame

FrameT = TypeVar("FrameT", bound=SensorFrame)


class Frames(Protocol[FrameT]):
    """Ranges of a sensor kind's frames, and frames without other things."""

    @property
    def range_bias_m(self) -> float:
        """Standard deviation of the error that all ranges of a frame share."""
        ...

    def image(self, frame: FrameT, *, fine: bool) -> RangeImage | None:
        """Return the ranges of a frame on few rays, or on many if ``fine``; None if they are unknown."""
        ...

    def separated(self, frame: FrameT, labels: NDArray[np.uint8], inside: NDArray[np.bool_]) -> FrameT:
        """Return a frame in which each ray is treated as its label says.

        Args:
            frame: the frame.
            labels: ``Label`` of each ray of its fine image, shape (rows, columns).
            inside: rays that must meet the target, same shape.
        """
        ...

    def behind_bodies(self, frame: FrameT, hides: NDArray[np.bool_]) -> FrameT:
        """Return a frame without measurements where known bodies are.

        Args:
            frame: the frame.
            hides: rays of its fine image on known bodies, shape (rows, columns).
        """
        ...

    def nearer(self, frame: FrameT, ratio: float) -> FrameT:
        """Return a frame whose ranges are divided by a ratio."""
        ...

    def part_of(self, part: FrameT, whole: FrameT) -> FrameT:
        """Return a separated frame that may contain the whole one, for ``whole_of``.

        A tracker within a search can then verify a pose in the whole frame.
        """
        ...

    def whole_of(self, frame: FrameT) -> FrameT | None:
        """Return the whole frame of a part that ``part_of`` has created; None if it is not kept."""
        ...

    def every_range_m(self, frame: FrameT) -> Float32Array:
        """Return the range of each pixel or ray of a frame, 0 without one, shape (rows, columns)."""
        ...
