"""Random records, with every field set to something that is not its default."""

import numpy as np

from neuse.embedding.code import Code
from neuse.geometry import Array, exp
from neuse.records import (
    ChangeKind,
    Edge,
    EdgeKind,
    Intrinsics,
    Keyframe,
    MapObject,
    MatchStatus,
    ObjectChange,
    ObjectMap,
    ObjectStatus,
    Observation,
    ObservedFrame,
    Rejection,
    TrackedFrame,
    TrackedObservation,
)

STAMP_NS = 1_700_000_000_123_456_789
INTRINSICS = Intrinsics(640, 480, 525.5, 524.5, 319.25, 239.75)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def transform(seed: int = 0) -> Array:
    return exp(rng(seed).normal(size=6))


def covariance(seed: int = 0) -> Array:
    root = rng(seed).normal(size=(6, 6))
    return root @ root.T


def code(seed: int = 0, k: int = 8) -> Code:
    r = rng(seed)
    descriptor = r.normal(size=k)
    z, sigmas = r.normal(size=(k, 3)), r.uniform(size=6)
    return Code("mug", True, z, descriptor / np.linalg.norm(descriptor), sigmas, float(r.uniform(-1, 1)))


def observation(seed: int = 0) -> Observation:
    r = rng(seed)
    cloud = r.normal(size=(5, 3)).astype(np.float32)
    return Observation(7, 0.625, code(seed), cloud, r.normal(size=3), 1234, touches_border=True)


def coarse_depth(seed: int = 0) -> np.ndarray:
    return rng(seed).uniform(0.1, 5.0, size=(6, 8)).astype(np.float32)


def observed_frame() -> ObservedFrame:
    rejections = (Rejection("empty_mask", "instance 3 has no pixels"),)
    return ObservedFrame(STAMP_NS, (observation(1), observation(2)), INTRINSICS, coarse_depth(), rejections)


def edge(seed: int = 0) -> Edge:
    return Edge(
        3, 9, STAMP_NS - 5, STAMP_NS, EdgeKind.LOOP_CLOSURE, transform(seed), covariance(seed), (4, 5), 0.25
    )


def tracked_frame() -> TrackedFrame:
    tracked = (
        TrackedObservation(observation(1), MatchStatus.MATCHED, 4, (8, 2)),
        TrackedObservation(observation(2), MatchStatus.TENTATIVE),
    )
    return TrackedFrame(
        STAMP_NS,
        transform(3),
        covariance(4),
        tracked,
        INTRINSICS,
        coarse_depth(),
        12,
        True,
        True,
        (edge(5),),
        6,
    )


def keyframes() -> tuple[Keyframe, ...]:
    return tuple(Keyframe(i, STAMP_NS + i, transform(i)) for i in range(4))


def change(kind: ChangeKind) -> ObjectChange:
    before = None if kind == ChangeKind.ADDED else transform(1)
    after = None if kind == ChangeKind.REMOVED else transform(2)
    return ObjectChange(STAMP_NS, kind, 5, "bottle", before, after, merged_id=11)


def object_map() -> ObjectMap:
    r = rng(9)
    known = MapObject(
        4, "mug", ObjectStatus.MOVED, transform(6), r.normal(size=3), r.uniform(size=3), code(7), 10, 20, 30
    )
    return ObjectMap(STAMP_NS, (known,))
