"""Order of message stamps, the only clock of the nodes, and the join of topics by equal stamps."""

from collections.abc import Sequence
from enum import Enum
from typing import Any

NANOSECONDS = 10**9


class Succession(Enum):
    """How a stamp follows the one before. STALE: repeated or out of order. RESTART: time has jumped back."""

    NEXT = "next"
    STALE = "stale"
    RESTART = "restart"


class StampOrder:
    """Watches a sequence of stamps. A step back by more than `restart_s` is a restart, as of a looped bag."""

    def __init__(self, restart_s: float) -> None:
        self._restart_ns = int(restart_s * NANOSECONDS)
        self._last_ns: int | None = None

    def follow(self, stamp_ns: int) -> Succession:
        """Place a stamp; it becomes the last one unless it is stale."""
        succession = self.place(stamp_ns)
        if succession != Succession.STALE:
            self._last_ns = stamp_ns
        return succession

    def place(self, stamp_ns: int) -> Succession:
        """Where a stamp lies, without taking it in."""
        if self._last_ns is None or stamp_ns > self._last_ns:
            return Succession.NEXT
        restarted = stamp_ns < self._last_ns - self._restart_ns
        return Succession.RESTART if restarted else Succession.STALE


class StampJoin:
    """Joins messages of several topics whose stamps are equal, in bounded memory.

    A complete set makes older incomplete ones hopeless, as every topic keeps its order.
    """

    def __init__(self, topics: Sequence[str], capacity: int) -> None:
        self._topics, self._capacity = tuple(topics), capacity
        self._waiting: dict[int, dict[str, Any]] = {}
        self._lost: list[tuple[int, list[str]]] = []

    def add(self, topic: str, stamp_ns: int, message: Any) -> tuple[Any, ...] | None:
        """The messages of this stamp in the order of `topics` once all are there, else None."""
        joined = self._waiting.setdefault(stamp_ns, {})
        joined[topic] = message
        if len(joined) == len(self._topics):
            del self._waiting[stamp_ns]
            self._give_up([older for older in self._waiting if older < stamp_ns])
            return tuple(joined[name] for name in self._topics)
        self._give_up(list(self._waiting)[: -self._capacity])
        return None

    def clear(self) -> None:
        """Forget what is waiting."""
        self._waiting.clear()

    def take_lost(self) -> list[tuple[int, list[str]]]:
        """What was given up since the last call, as (stamp_ns, missing topics)."""
        lost, self._lost = self._lost, []
        return lost

    def _give_up(self, stamps_ns: Sequence[int]) -> None:
        for stamp_ns in stamps_ns:
            joined = self._waiting.pop(stamp_ns)
            self._lost.append((stamp_ns, [name for name in self._topics if name not in joined]))
