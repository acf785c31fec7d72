"""Which changes explain what came and what went: moved, added or removed objects (NeuSE IV-D).

The tracker never moves an object: at a new place it instantiates a new one. So a move shows as one object
gone and a newcomer of its shape, often minutes apart. What is gone is reported within seconds; a newcomer
waits until the places that it may come from have been seen, and with it what is gone only because it stands
there. Should the other half of a move turn up after one half was reported, the MOVED supersedes that report
(see `settled_changes`). Of some newcomers no depth tells that they have come, as on a table where nothing has
stayed; they are never added, but may be what is gone.
"""

from collections.abc import Iterable, Set
from dataclasses import dataclass
from itertools import product

import numpy as np

from neuse.mapping.object_library import ObjectLibrary
from neuse.mapping.object_record import ObjectRecord
from neuse.params import CheckedParams, param
from neuse.records import ChangeKind, ObjectChange

_SAME_PLACE_M = 0.02  # an object that came back to its own place has not moved
_SHIFT_M = 0.1  # nearer than this to the place of an object gone, another may have taken that place:
_SHIFT_LIKENESS = 3.0  # so much more like itself must an object look that was only shifted,
_DOUBTFUL_LIKENESS = 3.0  # or that may as well be a discovery,
_TRADE_LIKENESS = 3.0  # and so much less one that stands where that stood which has its place now


@dataclass(frozen=True)
class ChangeParams(CheckedParams):
    """How long reports wait for the other half of a move, and how long they can be superseded by it."""

    hold_s: float = param(2.0, "an object gone or come is held back this long, s", 0.0, 1e6)
    pending_s: float = param(
        60.0, "an object come is held back this long while it may be from a place not seen since, s", 0.0, 1e6
    )
    doubtful_s: float = param(
        10.0,
        "an object gone for so long may be what is met without a sign that it has come, s",
        0.0,
        1e6,
    )
    move_likeness: float = param(
        3.0,
        "least evidence (log likelihood ratio) that a newcomer is an object gone, not one of twenty like it",
        -100.0,
        100.0,
    )
    memory_s: float = param(120.0, "an object reported this long ago explains no newcomer, s", 0.0, 1e6)


@dataclass(frozen=True)
class Move:
    """A newcomer that is an object gone from elsewhere."""

    object_id: int
    newcomer_id: int


@dataclass(frozen=True)
class Decision:
    """Changes that have become certain; ids of objects added and removed, each named once."""

    moves: tuple[Move, ...]
    added: tuple[int, ...]
    removed: tuple[int, ...]


@dataclass
class _Open:
    """Since when an object has been known to be gone or new, and when that was reported, if it was."""

    since_ns: int
    reported_ns: int | None = None


class ChangeDetector:
    """Pairs objects that are gone with newcomers of like shape; what stays alone is removed or added."""

    def __init__(self, params: ChangeParams) -> None:
        self._hold_ns = int(params.hold_s * 1e9)
        self._pending_ns = int(params.pending_s * 1e9)
        self._doubtful_ns = int(params.doubtful_s * 1e9)
        self._memory_ns = int(params.memory_s * 1e9)
        self._move_likeness = params.move_likeness
        self._gone: dict[int, _Open] = {}
        self._come: dict[int, _Open] = {}

    def note_gone(self, object_id: int, stamp_ns: int) -> None:
        """The object is no longer at its place."""
        self._gone.setdefault(object_id, _Open(stamp_ns))

    def note_present(self, object_id: int) -> None:
        """The object is at its place, after all."""
        self._gone.pop(object_id, None)

    def note_come(self, object_id: int, stamp_ns: int) -> None:
        """The object has come to a place that was free, or another's."""
        self._come.setdefault(object_id, _Open(stamp_ns))

    @property
    def waiting(self) -> set[int]:
        """Objects known to have come, which has not been reported yet."""
        return {object_id for object_id, entry in self._come.items() if entry.reported_ns is None}

    def forget(self, object_id: int) -> None:
        """The id has turned out to mean another object."""
        self._gone.pop(object_id, None)
        self._come.pop(object_id, None)

    def decide(
        self,
        library: ObjectLibrary,
        stamp_ns: int,
        final: bool,
        doubtful: Set[int] = frozenset(),
        disputed: Set[int] = frozenset(),
    ) -> Decision:
        """What has become certain by now; with `final` also what still waits.

        doubtful: newcomers that may have come or been overlooked before, which only their shape can tell.
        disputed: objects gone only if newcomers that wait are what they seem; not reported as removed yet.
        """
        self._expire(stamp_ns)
        candidates = self._candidates(library, stamp_ns, final) + self._returns(
            library, doubtful, stamp_ns, final
        )
        moves = self._moves(candidates)
        explained = {move.object_id for move in moves}
        waiting = {newcomer_id for _, newcomer_id, known_id in candidates if known_id not in explained}
        alone = [object_id for object_id in self._come if object_id not in waiting]
        sure = [(i, entry) for i, entry in self._gone.items() if i not in disputed]
        late = [i for i, entry in sure if final or stamp_ns - entry.since_ns >= self._hold_ns]
        alone = [i for i in alone if final or stamp_ns - self._come[i].since_ns >= self._hold_ns]
        added, removed = _report(alone, self._come, stamp_ns), _report(late, self._gone, stamp_ns)
        return Decision(tuple(moves), added, removed)

    def _moves(self, candidates: list[tuple[float, int, int]]) -> list[Move]:
        """The most alike of all open pairs, each object once, where the one is known to be gone."""
        moves, taken = [], set[int]()
        for _, newcomer_id, known_id in sorted(candidates, reverse=True):
            if newcomer_id in taken or known_id in taken:
                continue
            taken |= {newcomer_id, known_id}
            if known_id in self._gone:
                moves.append(Move(known_id, newcomer_id))
        for move in moves:
            self.forget(move.object_id)
            self.forget(move.newcomer_id)
        return moves

    def _candidates(self, library: ObjectLibrary, stamp_ns: int, final: bool) -> list[tuple[float, int, int]]:
        """(likeness, newcomer, object) of all pairs that may be one object.

        Objects whose places have not been seen since the newcomer came are candidates until it is late.
        """
        pairs = []
        for newcomer_id, entry in self._come.items():
            newcomer = library.records[newcomer_id]
            waits = not final and entry.reported_ns is None and not self._is_late(entry, stamp_ns)
            for known in library:
                if known.object_id in self._gone or (waits and known.is_present):
                    likeness = self._likeness(newcomer, known, library)
                    if likeness >= self._move_likeness:
                        pairs.append((likeness, newcomer_id, known.object_id))
        return pairs

    def _returns(
        self, library: ObjectLibrary, doubtful: Set[int], stamp_ns: int, final: bool
    ) -> list[tuple[float, int, int]]:
        """(likeness, newcomer, object) of objects long gone that doubtful newcomers, met of late, may be."""
        pairs = []
        long_gone = [i for i, e in self._gone.items() if final or stamp_ns - e.since_ns >= self._doubtful_ns]
        for newcomer_id, known_id in product(sorted(doubtful - self._come.keys()), long_gone):
            newcomer = library.records[newcomer_id]
            if self._gone[known_id].since_ns - newcomer.first_seen_ns < self._pending_ns:
                likeness = self._likeness(newcomer, library.records[known_id], library)
                if likeness >= self._move_likeness + _DOUBTFUL_LIKENESS:
                    pairs.append((likeness, newcomer_id, known_id))
        return pairs

    def _likeness(self, newcomer: ObjectRecord, known: ObjectRecord, library: ObjectLibrary) -> float:
        """Evidence that the newcomer is the known object, from elsewhere."""
        both_seen = known.last_tick >= newcomer.since_tick
        if both_seen or newcomer.object_id in self._gone:
            return -np.inf
        distance_m = np.linalg.norm(newcomer.center - known.center)
        if distance_m <= _SAME_PLACE_M:
            return -np.inf
        likeness = newcomer.likeness(known)
        if distance_m <= _SHIFT_M:
            return likeness - _SHIFT_LIKENESS
        return likeness + (_TRADE_LIKENESS if _have_traded(newcomer, known, library) else 0.0)

    def _is_late(self, entry: _Open, stamp_ns: int) -> bool:
        return stamp_ns - entry.since_ns >= self._pending_ns

    def _expire(self, stamp_ns: int) -> None:
        """What was reported long ago no longer explains anything."""
        for entries in (self._gone, self._come):
            for object_id, entry in list(entries.items()):
                if entry.reported_ns is not None and stamp_ns - entry.reported_ns >= self._memory_ns:
                    del entries[object_id]


def _have_traded(newcomer: ObjectRecord, known: ObjectRecord, library: ObjectLibrary) -> bool:
    """Whether the newcomer stands at the place that an object has left for that of the known one."""
    movers = [library.find(left.object_id) for left in library.left if _is_near(newcomer, left)]
    return any(_is_near(mover, known) for mover in movers if mover is not None)


def _is_near(one: ObjectRecord, other: ObjectRecord) -> bool:
    return bool(np.linalg.norm(one.center - other.center) <= _SHIFT_M)


def _report(object_ids: list[int], entries: dict[int, _Open], stamp_ns: int) -> tuple[int, ...]:
    """Those of the ids that have not been reported yet, marked as reported now."""
    fresh = tuple(object_id for object_id in object_ids if entries[object_id].reported_ns is None)
    for object_id in fresh:
        entries[object_id].reported_ns = stamp_ns
    return fresh


def settled_changes(changes: Iterable[ObjectChange]) -> tuple[ObjectChange, ...]:
    """A stream of reports without those that a later MOVED has superseded: its halves, if reported before."""
    settled: list[ObjectChange] = []
    for change in changes:
        if change.kind == ChangeKind.MOVED:
            _take_back(ChangeKind.REMOVED, change.object_id, settled)
            _take_back(ChangeKind.ADDED, change.merged_id, settled)
        settled.append(change)
    return tuple(settled)


def _take_back(kind: ChangeKind, object_id: int, reports: list[ObjectChange]) -> None:
    """Drop the last report of an object if it is of this kind."""
    last = next((i for i in reversed(range(len(reports))) if reports[i].object_id == object_id), None)
    if last is not None and reports[last].kind == kind:
        del reports[last]
