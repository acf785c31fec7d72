"""The way of changes from mapper to SLAM, with a fixed delay: results do not depend on how fast anyone is."""

from neuse.records import ObjectChange

DELAY_S = 1.0


class ChangeFeedback:
    """Holds each change until the first frame `delay_s` after the frame in which it was found.

    As long as the mapper lags by less, SLAM applies each change at the same frame, in one process or in many.
    """

    def __init__(self, delay_s: float = DELAY_S) -> None:
        self._delay_ns = int(delay_s * 1e9)
        self._waiting: list[ObjectChange] = []

    def add(self, change: ObjectChange) -> None:
        """Take in a change that the mapper has found."""
        self._waiting.append(change)

    def due(self, stamp_ns: int) -> list[ObjectChange]:
        """Changes that SLAM must apply before it works on this frame, in the order of their stamps."""
        due = [change for change in self._waiting if change.stamp_ns + self._delay_ns <= stamp_ns]
        self._waiting = [change for change in self._waiting if change.stamp_ns + self._delay_ns > stamp_ns]
        return sorted(due, key=lambda change: (change.stamp_ns, change.object_id))

    def clear(self) -> None:
        """Forget what waits."""
        self._waiting.clear()
