"""The front end: where is the camera, which object is each observation, which observations become objects."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from neuse.embedding.code import Code
from neuse.geometry import Array
from neuse.records import Observation
from neuse.slam.adoption import adopt
from neuse.slam.association import Association, AssociationParams, associate
from neuse.slam.completion import complete
from neuse.slam.displacement import DisplacementWatch
from neuse.slam.hypotheses import Hypothesis, best_hypothesis
from neuse.slam.instantiation import (
    InstantiationParams,
    expired,
    is_due,
    is_eligible,
    is_trackable,
    known_gates_m,
    may_be_known,
)
from neuse.slam.layout import View
from neuse.slam.library import ObjectLibrary, rather_rivals, unlikeness
from neuse.slam.localization import Belief, localize, to_map
from neuse.slam.nearest import associate_nearest
from neuse.slam.object_frames import ObjectFrames
from neuse.slam.odometry import Motion
from neuse.slam.prior_map import PriorMap
from neuse.slam.track import LastSighting, Track, heights_of, places_of

START_VARIANCE = 1e-8
LOST_COVARIANCE = np.diag([0.3**2] * 3 + [0.5**2] * 3)  # rad^2, m^2: of a prediction that objects refute


@dataclass(frozen=True)
class Located:
    """The camera's pose in a frame and the track of each observation (None: no known place).

    blind: no object constrained the pose.    relocalized: the pose was found without the prediction.
    surprised: the objects are not where the first hypothesis led, but another.
    """

    belief: Belief
    tracks: tuple[Track | None, ...]
    blind: bool
    relocalized: bool
    surprised: bool = False


class ObjectTracker:
    """Tracks the camera against the object library and keeps that library.

    The drift clock (rad^2, m^2) runs by the uncertainty of each frame's motion: fast when blind, slow when
    objects are in view; see drift.py.
    """

    def __init__(
        self, association: AssociationParams, instantiation: InstantiationParams, use_ambiguous: bool
    ) -> None:
        self.association = association
        self.instantiation = instantiation
        self.use_ambiguous = use_ambiguous
        self.library = ObjectLibrary()
        self._watch = DisplacementWatch(association, instantiation.min_sightings)
        self.belief = Belief(np.eye(4), START_VARIANCE * np.eye(6))
        self._drift = np.zeros(2)
        self._frame_index = 0

    def view(self, codes: Sequence[Code], frames: ObjectFrames, partial_centers: Array) -> View:
        """The usable observations of the next frame."""
        alike, rivals = self._rivals(codes)
        return View(tuple(codes), frames, partial_centers, tuple(alike), rivals)

    def locate(self, view: View, hypotheses: Sequence[Hypothesis]) -> Located:
        """Associate the view and find the camera's pose (NeuSE IV-A, B).

        hypotheses: where the camera may be, the most probable first; others serve where the first fails.
        """
        now = self._frame_index
        expected = min(len(view), int((self.library.table["last_frame"] == now).sum()))
        hypothesis, found = best_hypothesis(hypotheses, partial(self._associate, view), now, expected)
        prediction, motion = hypothesis
        if found.T_map_camera is not None:
            prediction = Belief(found.T_map_camera, LOST_COVARIANCE)
        belief = self._localize(view, found.tracks, prediction, found.T_map_camera)
        tracks = self._candidates(view, belief.T_map_camera, found.tracks)
        settled = self.library.table.drifts(tracks, self._drift)
        matched = complete(view, found.tracks, tracks, settled, belief, self.association, now)
        if matched != found.tracks:
            belief = self._localize(view, matched, prediction, belief.T_map_camera)
        matched = _joined(matched, found.apart)
        self.belief = belief
        self._advance(belief, motion)
        for track in self._watch.displaced(view, matched, tracks, belief.T_map_camera, now):
            track.retired = True
        return Located(
            belief=belief,
            tracks=matched,
            blind=not self._used(view, matched),
            relocalized=found.T_map_camera is not None,
            surprised=hypothesis is not hypotheses[0],
        )

    def correct(self, T_map_camera: Array) -> None:
        """The graph knows the current pose better."""
        self.belief = replace(self.belief, T_map_camera=T_map_camera)

    def update(
        self, view: View, observations: Sequence[Observation], located: Located
    ) -> tuple[tuple[Track | None, ...], list[Track]]:
        """Take the frame's observations into the library.

        Returns:
            The track of each observation, tentative ones included, and the tracks that became objects just
            now.
        """
        placed = to_map(self.belief.T_map_camera, view.frames.vectors)
        tracks: list[Track | None] = []
        for i, (observation, track) in enumerate(zip(observations, located.tracks, strict=True)):
            last = LastSighting(view.frames[[i]], view.partial_centers[i], self.belief.T_map_camera)
            tracks.append(self._seen(observation, placed[:, i], last, track))
        self.library.drop(expired(self.library.tentative(), self._frame_index, self.instantiation))
        return tuple(tracks), self._confirm([track for track in tracks if track is not None])

    def move(self, T_target_map: Array) -> None:
        """The map frame becomes another: p_target = T_target_map @ p_map."""
        self.correct(T_target_map @ self.belief.T_map_camera)
        for track in self.library.tracks.values():
            track.place = to_map(T_target_map, track.place[:, None])[:, 0]
            track.last = replace(track.last, T_map_camera=T_target_map @ track.last.T_map_camera)

    def near_at_hand(self, min_sightings: int, max_drift_m: float) -> list[Track]:
        """Active tracks whose places are well known relative to the camera, the last seen first."""
        seen = [track for track in self.library.active() if track.n_sightings >= min_sightings]
        if not seen:
            return []
        drifts_m = np.sqrt(self.library.table.drifts(seen, self._drift)[:, 1])
        near = [track for track, drift_m in zip(seen, drifts_m, strict=True) if drift_m <= max_drift_m]
        return sorted(near, key=lambda track: (-track.last_frame, track.key))

    def adopt(self, prior: PriorMap, matches: Mapping[int, int]) -> list[Track]:
        """Take over the objects of a map that are not known yet; the tracks that stand for them.

        matches: {track key: object id} of tracks of its own that are such objects.
        """
        return adopt(prior, matches, self.library, self._drift, self.association)

    def enter_graph(self, seen: Sequence[Track]) -> list[Track]:
        """Those tracks of a keyframe that have now been seen often enough to constrain keyframes."""
        due = [t for t in seen if not t.in_graph and t.n_sightings >= self.instantiation.min_sightings]
        for track in due:
            self.library.name(track)
            track.in_graph = True
        return due

    def _rivals(self, some: Sequence[Code | Track]) -> tuple[list[Track], tuple[Track | None, ...]]:
        """All that may be alike in shape, and of each what it is if not the one in whose place it is."""
        delta_shape = self.association.delta_shape
        alike = self.library.alike(some, delta_shape)
        return alike, self.library.rivals(some, alike, delta_shape, self._frame_index)

    def _associate(self, view: View, hypothesis: Hypothesis) -> Association:
        prediction, motion = hypothesis
        if self.association.method == "nearest":
            return associate_nearest(view, self.library.active(), self.association)
        tracks = self._candidates(view, prediction.T_map_camera)
        drift = self.library.table.drifts(tracks, self._drift + _worst_variances(motion.covariance))
        return associate(view, tracks, drift, prediction, self.association, self._frame_index)

    def _candidates(
        self, view: View, T_map_camera: Array, matched: Sequence[Track | None] | None = None
    ) -> list[Track]:
        """What may be matched from this pose: tracks that stand near, and those already matched if they are.

        As long as nothing is, also objects alike in shape wherever they stand, from which a lost camera is
        found.
        """
        if not len(view):
            return []
        params, library = self.association, self.library
        points = to_map(T_map_camera, view.frames.vectors)[0]
        chosen = library.around(points, params.max_gate_m)
        if matched is None:
            most = params.max_candidates + len(view)
            chosen |= library.most_alike(view.codes, view.alike, params.delta_shape, most)
        else:
            chosen[library.table.index(track for track in matched if track is not None)] = True
        return library.table.at(chosen)

    def _seen(
        self, observation: Observation, place: Array, last: LastSighting, track: Track | None
    ) -> Track | None:
        if track is not None:
            track.see(observation.code, place, last, self._drift, self._frame_index)
        elif is_trackable(observation, self.instantiation):
            track = self.library.add(observation.code, place, last, self._drift, self._frame_index)
        else:
            return None
        track.n_eligible += is_eligible(observation, self.instantiation)
        return track

    def _confirm(self, seen: Sequence[Track]) -> list[Track]:
        due = [track for track in seen if is_due(track, False, self.instantiation)]
        if not due:
            return []
        table, matched = self.library.table, {track.key for track in seen}
        is_object = table["active"] & table["confirmed"]
        drifts = table.all_drifts(self._drift, is_object)
        delta_prox_m, fresh = self.association.delta_prox_m, []
        for track in due:
            near = is_object & table.near(track.place[0], known_gates_m(drifts, delta_prox_m))
            known = table.at(near)
            alike = unlikeness([track], known)[0] <= self.association.max_unlikeness
            alike &= ~rather_rivals([track], self._rivals([track])[1], known)[0]
            doubtful = may_be_known(track, alike, known, drifts[near], matched, delta_prox_m)
            if is_due(track, doubtful, self.instantiation):
                self.library.confirm(track)
                fresh.append(track)
        return fresh

    def _localize(
        self, view: View, tracks: Sequence[Track | None], prediction: Belief, start: Array | None
    ) -> Belief:
        used = self._used(view, tracks)
        if not used:
            return prediction
        known = [track for i in used if (track := tracks[i]) is not None]
        seen = view.frames[used].given_heights(*heights_of(known))
        return localize(seen, places_of(known), prediction, start)

    def _used(self, view: View, tracks: Sequence[Track | None]) -> list[int]:
        """Observations that may constrain the pose."""
        allowed = view.frames.ambiguous <= self.use_ambiguous
        return [i for i, track in enumerate(tracks) if track is not None and allowed[i]]

    def _advance(self, belief: Belief, motion: Motion) -> None:
        self._frame_index += 1
        step = np.minimum(_worst_variances(motion.covariance), _worst_variances(belief.covariance))
        self._drift = self._drift + step


def _joined(matched: Sequence[Track | None], apart: Sequence[Track | None]) -> tuple[Track | None, ...]:
    """The matches, and where a tentative track or none was matched those that lie apart."""
    taken = {track.key for track in matched if track is not None}
    result = list(matched)
    for i, track in enumerate(apart):
        current = matched[i]
        if track is not None and track.key not in taken and (current is None or not current.confirmed):
            result[i] = track
    return tuple(result)


def _worst_variances(covariance: Array) -> Array:
    """(2,) largest variance of rotation (rad^2) and of translation (m^2)."""
    return np.array([np.linalg.eigvalsh(covariance[:3, :3])[-1], np.linalg.eigvalsh(covariance[3:, 3:])[-1]])
