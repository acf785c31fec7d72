"""One named thread with a bounded queue, so that slow work never holds up the reception of messages."""

import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

Item = TypeVar("Item")


class Worker(Generic[Item]):
    """Works through items in their order. When the queue is full the oldest waiting item is dropped.

    work: called in the thread with one item; must not raise.    dropped: called for each dropped item.
    """

    def __init__(
        self, name: str, work: Callable[[Item], None], capacity: int, dropped: Callable[[Item], None]
    ) -> None:
        self._work, self._capacity, self._dropped = work, capacity, dropped
        self._items: deque[Item] = deque()
        self._changed = threading.Condition()
        self._busy = self._stopping = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def put(self, item: Item) -> None:
        """Append an item and return at once."""
        dropped = []
        with self._changed:
            self._items.append(item)
            if len(self._items) > self._capacity:
                dropped.append(self._items.popleft())
            self._changed.notify_all()
        for old in dropped:
            self._dropped(old)

    @property
    def waiting(self) -> int:
        """How many items wait."""
        return len(self._items)

    def drain(self, timeout_s: float) -> bool:
        """Wait until everything is worked through; False if it took longer than the timeout."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._items and not self._busy, timeout_s)

    def stop(self, timeout_s: float = 5.0) -> None:
        """End the thread after the item at hand; what still waits is left."""
        with self._changed:
            self._stopping = True
            self._changed.notify_all()
        self._thread.join(timeout_s)

    def _run(self) -> None:
        while (item := self._next()) is not None:
            self._work(item)
            with self._changed:
                self._busy = False
                self._changed.notify_all()

    def _next(self) -> Item | None:
        with self._changed:
            self._changed.wait_for(lambda: self._items or self._stopping)
            if self._stopping:
                return None
            self._busy = True
            return self._items.popleft()
