"""What is told of an observation once it has been tracked (NeuSE IV-B)."""

from collections.abc import Sequence

from neuse.records import NO_ID, MatchStatus, Observation, TrackedObservation
from neuse.slam.track import Track


def tracked_observation(
    observation: Observation, track: Track | None, similar_ids: tuple[int, ...], fresh: Sequence[Track]
) -> TrackedObservation:
    """The observation with its object, if it has one, and others of like shape.

    similar_ids: known objects of like shape, most similar first.    fresh: tracks that just became objects.
    """
    if track is not None and track.confirmed:
        status = MatchStatus.NEW if track in fresh else MatchStatus.MATCHED
        others = tuple(i for i in similar_ids if i != track.object_id)
        return TrackedObservation(observation, status, track.object_id, others)
    status = MatchStatus.UNMATCHED if similar_ids else MatchStatus.TENTATIVE
    return TrackedObservation(observation, status, NO_ID, similar_ids)
