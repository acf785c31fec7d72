"""Object SLAM: codes and odometry in; camera poses, matched objects and graph edges out (NeuSE IV-A to C)."""

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from neuse.errors import InputError
from neuse.geometry import Array
from neuse.records import (
    NO_ID,
    ChangeKind,
    Edge,
    Keyframe,
    MatchStatus,
    ObjectChange,
    ObservedFrame,
    OdometrySample,
    TrackedFrame,
    TrackedObservation,
)
from neuse.slam.external import ExternalEdges
from neuse.slam.keyframe_graph import KeyframeGraph
from neuse.slam.keyframes import KeyframeRecord
from neuse.slam.layout import View
from neuse.slam.library import ids_by_likeness
from neuse.slam.object_frames import is_usable, reduce_codes
from neuse.slam.odometry import OdometryFix
from neuse.slam.outcome import tracked_observation
from neuse.slam.params import SlamParams
from neuse.slam.prediction import Predictor
from neuse.slam.prior_map import PriorMap
from neuse.slam.relocalization import Place
from neuse.slam.track import Track
from neuse.slam.tracker import ObjectTracker
from neuse.stopwatch import Stopwatch

PLACES_AT_ONCE = 100  # read from a solution by turns, beside those in sight; all when it has moved the map
Tracks = Sequence[Track | None]  # of each observation of a frame


class ObjectSlam:
    """Online object SLAM. Not thread-safe: wrap it from outside.

    counters: unusable input since the last reset, by reason.    stopwatch: times of the last step.
    """

    def __init__(self, params: SlamParams | None = None) -> None:
        self.params = params or SlamParams()
        self.reset()

    def reset(self) -> None:
        """Forget everything; the next frame defines a new map frame."""
        params = self.params
        self.counters: Counter[str] = Counter()
        self.stopwatch = Stopwatch()
        self._tracker = ObjectTracker(params.association, params.instantiation, params.use_ambiguous)
        self._predictor = Predictor(params.odometry, self.counters)
        self._graph = KeyframeGraph(params)
        self._externals = ExternalEdges(params.stamp_tolerance_s, self.counters)
        self._last_stamp_ns: int | None = None

    def step(self, frame: ObservedFrame, odometry: OdometrySample | None) -> TrackedFrame:
        """Track one frame.

        Args:
            frame: all objects of the frame; observations with unusable codes are counted and stay TENTATIVE.
            odometry: the sample at the frame's stamp, None if there is none.
        Raises:
            InputError: `stamp_backwards`, the frame is not later than the one before.
        """
        self._check_stamp(frame.stamp_ns)
        self.stopwatch.reset()
        usable = self._usable(frame)
        view = self._view(frame, usable)
        fix, hypotheses = self._predictor.predict(self._tracker.belief, odometry, frame.stamp_ns)
        with self.stopwatch.timed("associate"):
            located = self._tracker.locate(view, hypotheses)
            tracks, fresh = self._tracker.update(view, [frame.observations[i] for i in usable], located)
        fix, edges, loop_closed = self._predictor.judge(fix, located), list[Edge](), False
        rejected_before = self._graph.rejected_edges
        keyframe = (
            bool(fresh) or located.relocalized or self._graph.library.is_due(located.belief.T_map_camera)
        )
        if keyframe:
            record = self._record(frame.stamp_ns, view, tracks, fix)
            clouds = {
                track.key: frame.observations[i].cloud
                for i, track in zip(usable, tracks, strict=True)
                if track is not None and track.key in record.keys
            }
            edges, loop_closed = self._add_keyframe(record, clouds)
            self.add_external_edges(())  # those that have waited long enough
        self._predictor.settle(fix, self._tracker.belief)
        self._graph.library.add_frame(frame.stamp_ns, self._tracker.belief.T_map_camera)
        return TrackedFrame(
            stamp_ns=frame.stamp_ns,
            T_map_camera=self._tracker.belief.T_map_camera,
            covariance=self._covariance(keyframe),
            observations=self._tracked(frame, usable, view, tracks, fresh),
            intrinsics=frame.intrinsics,
            coarse_depth_m=frame.coarse_depth_m,
            keyframe_id=len(self._graph.library.records) - 1 if keyframe else NO_ID,
            loop_closed=loop_closed or located.relocalized,
            odometry_only=located.blind,
            edges=tuple(edges),
            rejected_edges=self._graph.rejected_edges - rejected_before,
        )

    def near_at_hand(self, min_sightings: int, max_drift_m: float) -> list[Track]:
        """Objects whose places are well known relative to the camera, the last seen first."""
        return self._tracker.near_at_hand(min_sightings, max_drift_m)

    def count_ids(self, first: int, step: int) -> None:
        """New objects are called `first`, `first + step`, ... from now on."""
        self._tracker.library.count_ids(first, step)

    def join(self, prior: PriorMap, place: Place) -> dict[int, int]:
        """Go on inside a map made by others; {id before: id now} of objects that are called otherwise.

        Those that both know get the map's names, and others a new one where theirs means, or once meant,
        something else in the map; see `count_ids`.
        """
        renamed = self._tracker.library.rename(place.matches, prior.next_id)
        self._graph.move(place.T_map_session, place.covariance)
        self._predictor.correct(np.eye(4), place.T_map_session)
        self._tracker.move(place.T_map_session)
        self._adopt(prior, place.matches)
        self._solve()
        return renamed

    def learn(self, prior: PriorMap) -> None:
        """Take over what a map that has been joined has got to know since."""
        self._adopt(prior, {})

    def places(self) -> dict[int, Array]:
        """{object id: (3,) centre, map frame} of all objects that stand somewhere."""
        active = self._tracker.library.active()
        return {track.object_id: track.place[0] for track in active if track.object_id != NO_ID}

    def _adopt(self, prior: PriorMap, matches: Mapping[int, int]) -> None:
        adopted = self._tracker.adopt(prior, matches)
        entering = [track for track in adopted if not track.in_graph]
        for track in entering:
            track.in_graph = True
        self._graph.add_earlier_sightings(entering)
        self._graph.add_known(adopted)

    def apply_change(self, change: ObjectChange) -> None:
        """Take the mapper's word for a change: places that an object left never match again.

        A change of an object that is not known (for instance after a reset) is counted and ignored.
        """
        known = [track for track in self._tracker.library.named(change.object_id) if not track.retired]
        if change.kind == ChangeKind.ADDED:
            return
        if not known:
            self.counters["change_of_unknown_object"] += 1
        for track in known:
            track.retired = True
        if change.kind == ChangeKind.MOVED and change.merged_id not in (NO_ID, change.object_id):
            for track in self._tracker.library.named(change.merged_id):
                track.object_id = change.object_id

    def add_external_edges(self, edges: Sequence[Edge]) -> int:
        """Add edges of an external SLAM, whose ends are named by their stamps.

        Returns:
            How many were accepted now. Others, such as edges with unknown stamps or wrong ones, are counted;
            some wait until it is known whether they can be trusted.
        """
        accepted = self._externals.accept(edges, self._graph)
        if accepted:
            self._graph.add_external(accepted)
            self._solve()
        return len(accepted)

    @property
    def keyframes(self) -> tuple[Keyframe, ...]:
        """All keyframes with their latest estimates."""
        return self._graph.all()

    @property
    def graph_size(self) -> int:
        """How many keyframes are in the graph; others have left it."""
        return self._graph.size

    def moved_keyframes(self) -> tuple[Keyframe, ...]:
        """Those that are new or may have moved since this was asked last; all of them after a closure."""
        return self._graph.moved()

    def trajectory(self) -> list[tuple[int, Array]]:
        """(stamp_ns, T_map_camera) of every frame, through its keyframe's latest estimate."""
        return self._graph.trajectory()

    def _check_stamp(self, stamp_ns: int) -> None:
        if self._last_stamp_ns is not None and stamp_ns <= self._last_stamp_ns:
            raise InputError(
                "stamp_backwards",
                f"frame {stamp_ns} ns is not later than {self._last_stamp_ns} ns; drop it, or reset",
            )
        self._last_stamp_ns = stamp_ns

    def _usable(self, frame: ObservedFrame) -> list[int]:
        usable = [i for i, observation in enumerate(frame.observations) if is_usable(observation.code)]
        self.counters["code_not_finite"] += len(frame.observations) - len(usable)
        return usable

    def _view(self, frame: ObservedFrame, usable: Sequence[int]) -> View:
        observations = [frame.observations[i] for i in usable]
        codes = tuple(observation.code for observation in observations)
        partial_centers = np.array([observation.partial_center for observation in observations]).reshape(
            -1, 3
        )
        frames = reduce_codes(codes, self.params.sigmas)
        return self._tracker.view(codes, frames, partial_centers)

    def _tracked(
        self, frame: ObservedFrame, usable: Sequence[int], view: View, tracks: Tracks, fresh: Sequence[Track]
    ) -> tuple[TrackedObservation, ...]:
        similar = ids_by_likeness(view.codes, [*view.alike, *fresh], self.params.association.delta_shape)
        tracked = [TrackedObservation(unusable, MatchStatus.TENTATIVE) for unusable in frame.observations]
        for i, track, similar_ids in zip(usable, tracks, similar, strict=True):
            tracked[i] = tracked_observation(frame.observations[i], track, similar_ids, fresh)
        return tuple(tracked)

    def _record(self, stamp_ns: int, view: View, tracks: Tracks, fix: OdometryFix | None) -> KeyframeRecord:
        """What the new keyframe sees of objects that may constrain poses."""
        allowed = view.frames.ambiguous <= self.params.use_ambiguous
        rows = [i for i, track in enumerate(tracks) if track is not None and allowed[i]]
        keys = np.array([track.key for i in rows if (track := tracks[i]) is not None], dtype=np.intp)
        return KeyframeRecord(len(self._graph.library.records), stamp_ns, keys, view.frames[rows], fix)

    def _add_keyframe(
        self, record: KeyframeRecord, clouds: Mapping[int, np.ndarray]
    ) -> tuple[list[Edge], bool]:
        """Extend the graph by a keyframe and solve it.

        Returns:
            Its edges that are worth publishing, and whether it closes a loop.
        """
        tracks, params = self._tracker.library.tracks, self.params.edges
        well_seen = record.frames.variances[0] <= params.period_sigma_m**2
        for key in record.keys[well_seen].tolist():
            tracks[key].enter_keyframe(record.keyframe_id, params.period_gap, params.closure_spacing)
        seen, T_map_camera = [tracks[key] for key in record.keys.tolist()], self._tracker.belief.T_map_camera
        entering = self._tracker.enter_graph(seen)
        with self.stopwatch.timed("edge"):
            edges = self._graph.edges_of(record, clouds, tracks, T_map_camera)
        odometry, guessed = self._predictor.edge(self._graph.last, record, edges.short_range)
        self._graph.add_earlier_sightings(entering)
        in_graph = [track for track in seen if track.in_graph]
        self._graph.add(record, T_map_camera, [*odometry, *guessed], edges, in_graph)
        with self.stopwatch.timed("optimise"):
            self._graph.thin(tracks)
            self._solve()
        told = [*odometry, *edges.short_range, *self._graph.borne_out(edges.closures)]
        return told, bool(edges.closures)

    def _solve(self) -> None:
        T_last_camera = self._graph.relative_to_last(self._tracker.belief.T_map_camera)
        moved = self._graph.solve()
        library, last = self._tracker.library, self._graph.library.records[-1]
        most = len(library.tracks) if moved else PLACES_AT_ONCE
        self._graph.place(library.by_turns(last.keys.tolist(), most))
        T_map_camera = self._graph.library.T_map_camera[-1] @ T_last_camera
        self._predictor.correct(self._tracker.belief.T_map_camera, T_map_camera)
        self._tracker.correct(T_map_camera)

    def _covariance(self, is_keyframe: bool) -> Array:
        """Covariance of the current pose in the map: the keyframe's, and that of a frame beside it."""
        belief = self._tracker.belief
        of_keyframe = self._graph.covariance(belief.T_map_camera)
        return of_keyframe if is_keyframe else of_keyframe + belief.covariance
