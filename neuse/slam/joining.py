"""A session that joins a map: it waits until it has found its place there, and then tells all it has seen.

Until then it runs in its own frame, and its frames are held back. Once the place is certain, the whole
session moves into the map, objects that the map knows take the map's ids, and the frames go out as if they
had been in the map from the start. So nobody downstream ever meets two frames of reference.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from neuse.geometry import Array
from neuse.params import CheckedParams, param
from neuse.records import NO_ID, Edge, TrackedFrame, TrackedObservation
from neuse.slam.prior_map import MAX_HELD_FRAMES, PriorMap, in_their_places
from neuse.slam.relocalization import RelocalizationParams
from neuse.slam.relocalizer import Relocalizer
from neuse.slam.slam import ObjectSlam


@dataclass(frozen=True)
class JoiningParams(CheckedParams):
    """How a session joins a map."""

    wait_for_map: bool = param(
        False, "wait for a map even before one is heard of; false: the first frame begins a map"
    )
    max_held_frames: int = param(
        MAX_HELD_FRAMES,
        "frames that are held back until the map is joined; beyond it the oldest goes",
        2,
        1000000,
    )
    session: int = param(0, "number of this session among those that share one mapper", 0, 1000)
    sessions: int = param(1, "how many sessions share one mapper; each names objects in turn", 1, 1000)
    relocalization: RelocalizationParams = field(default_factory=RelocalizationParams)


class Joiner:
    """Stands between a session's SLAM and whoever hears its frames.

    is_waiting: there is a map, and the session has not yet found its place in it.
    """

    def __init__(self, slam: ObjectSlam, params: JoiningParams | None = None) -> None:
        self.params = params or JoiningParams()
        self._slam = slam
        self._relocalizer = Relocalizer(self.params.relocalization)
        self._prior: PriorMap | None = None
        self._held: deque[TrackedFrame] = deque()
        self.begin()

    @property
    def n_held(self) -> int:
        """How many frames wait."""
        return len(self._held)

    def begin(self) -> None:
        """The session begins anew, in the last map that was offered if there is one."""
        self._slam.reset()
        self._held.clear()
        self._relocalizer.forget()
        self.is_waiting = bool(self._prior) or self.params.wait_for_map
        self._count_ids(self._prior.next_id if self._prior else 0)

    def offer(self, prior: PriorMap) -> bool:
        """There is a map to join, or there is none any more; whether the session begins anew for it.

        A session that is in the map already learns what is new in it.
        """
        before, self._prior = self._prior, prior if len(prior) else None
        if not self.is_waiting and (self._prior is None or self._is_inside(prior)):
            self._slam.learn(prior)
            return False
        if self.is_waiting and self._prior is not None and _is_same_map(before, prior):
            return False
        self.begin()
        return True

    def follow(self, frame: TrackedFrame) -> list[TrackedFrame]:
        """Take in the frame that SLAM has just made; the frames that may go out now, in order."""
        if not self.is_waiting:
            return [frame]
        self._hold(frame)
        if self._prior is None:
            return []
        params = self.params.relocalization
        tracks = self._slam.near_at_hand(params.min_sightings, params.max_drift_m)
        place = self._relocalizer.look(tracks, self._prior, frame.T_map_camera)
        if place is None:
            return []
        self._count_ids(max((self._prior.next_id, *(name + 1 for name in self._slam.places()))))
        renamed = self._slam.join(self._prior, place)
        self.is_waiting = False
        T_map_camera = dict(self._slam.trajectory())
        out = [moved(held, T_map_camera[held.stamp_ns], renamed) for held in self._held]
        self._held.clear()
        return [*out[:-1], replace(out[-1], loop_closed=True)]

    def _hold(self, frame: TrackedFrame) -> None:
        """Beyond the limit the oldest goes, but for the very first, which tells that a session begins."""
        self._held.append(frame)
        if len(self._held) > self.params.max_held_frames:
            del self._held[1]

    def _is_inside(self, prior: PriorMap) -> bool:
        """Whether the session's objects are those of the map."""
        return bool(in_their_places(self._slam.places(), prior.places))

    def _count_ids(self, used: int) -> None:
        """Names that no object of the map and no other session has."""
        params = self.params
        first = used + (params.session - used) % params.sessions
        self._slam.count_ids(first, params.sessions)


def _is_same_map(before: PriorMap | None, now: PriorMap) -> bool:
    """Whether a map is that waited for before, if any, but for what it has got to know since."""
    return before is None or in_their_places(before.places, now.places) is not False


def moved(frame: TrackedFrame, T_map_camera: Array, renamed: Mapping[int, int]) -> TrackedFrame:
    """A frame of a session where it lies in the map that the session has joined."""
    return replace(
        frame,
        T_map_camera=T_map_camera,
        observations=tuple(_renamed(tracked, renamed) for tracked in frame.observations),
        edges=tuple(_renamed_edge(edge, renamed) for edge in frame.edges),
    )


def _renamed(tracked: TrackedObservation, renamed: Mapping[int, int]) -> TrackedObservation:
    similar = dict.fromkeys(renamed.get(i, i) for i in tracked.similar_ids)
    object_id = renamed.get(tracked.object_id, tracked.object_id)
    if tracked.object_id != NO_ID:
        similar.pop(object_id, None)
    return replace(tracked, object_id=object_id, similar_ids=tuple(similar))


def _renamed_edge(edge: Edge, renamed: Mapping[int, int]) -> Edge:
    return replace(edge, object_ids=tuple(renamed.get(i, i) for i in edge.object_ids))
