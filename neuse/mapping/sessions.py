"""Several sessions, one map: of robots that drive at the same time, or of one that was started again.

A session counts its keyframes from 0 and begins wherever its camera was. Its frames enter the map if it
founded the map or has joined it: when the objects that it names stand where the map has them.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count

from neuse.geometry import Array, transform_points
from neuse.mapping.mapper import ObjectMapper
from neuse.records import NO_ID, Keyframe, MatchStatus, TrackedFrame
from neuse.slam.prior_map import MAX_HELD_FRAMES, WITNESSES, in_their_places

Step = tuple[TrackedFrame, Sequence[Keyframe]]
STRIDE = 1_000_000  # keyframes of one session


@dataclass
class _Session:
    """is_member: its frames are in the map.    first_key: of its keyframes, as the mapper calls them.

    held: its frames while it is no member.    named: {object id: (3,) centre, map frame} as they saw it last.
    """

    first_key: int
    is_member: bool = True
    has_begun: bool = False
    held: deque[Step] = field(default_factory=lambda: deque[Step](maxlen=MAX_HELD_FRAMES))
    named: dict[int, Array] = field(default_factory=dict)

    def let_go(self) -> list[Step]:
        """The frames that were held; none is from now on."""
        held = list(self.held)
        self.held.clear()
        self.named.clear()
        return held


class Sessions:
    """Lets the frames of sessions into a map, held back ones once their session turns out to be in it."""

    def __init__(self, mapper: ObjectMapper, n_sessions: int = 1) -> None:
        self._mapper, self._n_sessions = mapper, n_sessions
        self.forget()

    def forget(self) -> None:
        """Begin anew with an empty map."""
        self._first_keys = count(0, STRIDE)
        self._sessions = [_Session(next(self._first_keys)) for _ in range(self._n_sessions)]

    def distrust(self) -> None:
        """The map has been replaced by another: every session has to show that it is in it."""
        for session in self._sessions:
            session.is_member = False
            session.let_go()

    @property
    def has_strangers(self) -> bool:
        """Whether a session is not in the map, and should be told of it."""
        return not all(session.is_member for session in self._sessions)

    def admit(self, frame: TrackedFrame, keyframes: Sequence[Keyframe], index: int = 0) -> list[Step]:
        """The steps that the mapper shall take now that this frame of a session has come."""
        session = self._sessions[index]
        if frame.keyframe_id == 0:
            self._begin(session, index)
        if session.is_member:
            return [_renumbered(frame, keyframes, session.first_key)]
        session.held.append((frame, keyframes))
        session.named |= _named(frame)
        agrees = self._agrees(session.named)
        if agrees is None:
            return []
        session.is_member, held = agrees, session.let_go()
        return [_renumbered(*step, session.first_key) for step in held] if agrees else []

    def _begin(self, session: _Session, index: int) -> None:
        """A session begins, or begins again."""
        others_have_begun = any(other.has_begun for other in self._sessions if other is not session)
        if session.has_begun:
            session.first_key = next(self._first_keys)
            self._mapper.settle_names(index, self._n_sessions)
        session.has_begun = True
        session.is_member = not self._mapper.places() and not others_have_begun
        session.let_go()

    def _agrees(self, named: Mapping[int, Array]) -> bool | None:
        """Whether most objects that a session names are where the map has them; None while they are few."""
        known = self._mapper.places()
        if len(named.keys() & known.keys()) < min(WITNESSES, len(known)):
            return None
        return in_their_places(named, known)


def _named(frame: TrackedFrame) -> dict[int, Array]:
    """{object id: (3,) centre, map frame} of the known objects that a frame saw."""
    return {
        tracked.object_id: transform_points(frame.T_map_camera, tracked.observation.code.center)
        for tracked in frame.observations
        if tracked.status == MatchStatus.MATCHED
    }


def _renumbered(frame: TrackedFrame, keyframes: Sequence[Keyframe], first_key: int) -> Step:
    """The same step with keyframes counted from `first_key`."""
    if first_key == 0:
        return frame, keyframes
    if frame.keyframe_id != NO_ID:
        frame = replace(frame, keyframe_id=first_key + frame.keyframe_id)
    return frame, [replace(k, keyframe_id=first_key + k.keyframe_id) for k in keyframes]
