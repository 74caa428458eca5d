"""Frames that a device counted but that did not arrive."""


class GapCounter:
    """Counts the numbers that are missing in a device's frame counter, over all connections."""

    def __init__(self) -> None:
        self.lost = 0
        """Number of frames that did not come."""
        self._last: int | None = None

    def begin(self) -> None:
        """Begin a connection: the device may count anew."""
        self._last = None

    def take(self, number: int | None) -> None:
        """Take the number of a frame that came, None if the device gives none."""
        if number is not None and self._last is not None and number > self._last:
            self.lost += number - self._last - 1
        self._last = number
