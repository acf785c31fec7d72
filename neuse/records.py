"""What flows between the stages: camera -> observations -> tracked frames -> object map. One dataclass a
record.

Each record has a message twin in neuse_msgs. Frames: `camera` is the optical frame (z forward, x right, y
down), `map` the world of the estimate, `odom` the odometry's own. Stamps are integer nanoseconds.
"""

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from neuse.embedding.code import Code
from neuse.geometry import Array

NO_ID = -1
MOST_PX = 1e6  # of any picture


@dataclass(frozen=True)
class Intrinsics:
    """Pinhole camera; pixels."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    @property
    def is_sound(self) -> bool:
        """Whether a camera can have these: sizes and focal lengths above zero, nothing beyond all pixels."""
        numbers = (self.width, self.height, self.fx, self.fy, self.cx, self.cy)
        return min(numbers[:4]) > 0 and all(abs(number) < MOST_PX for number in numbers)  # NaN compares false


@dataclass(frozen=True)
class Instance:
    """One entry of a segmentation: the mask's label, what it is, and the detector's score in [0, 1]."""

    label: int
    category: str
    score: float = 1.0


@dataclass(frozen=True)
class RgbdFrame:
    """A segmented depth image.

    depth_m: (h, w) float32, metres along z, 0 or NaN where there is no reading.
    mask: (h, w) integer labels, 0 = background.    color: (h, w, 3) uint8 RGB or None; only pictures use it.
    """

    stamp_ns: int
    depth_m: np.ndarray
    mask: np.ndarray
    instances: tuple[Instance, ...]
    intrinsics: Intrinsics
    color: np.ndarray | None = None


@dataclass(frozen=True)
class Observation:
    """One object seen in one frame.

    code: latent code in the camera frame.    cloud: (m, 3) float32 sub-sampled points, camera frame, metres.
    partial_center: (3,) mean of the observed points, camera frame.    mask_px: mask size in pixels.
    """

    label: int
    score: float
    code: Code
    cloud: np.ndarray
    partial_center: Array
    mask_px: int
    touches_border: bool = False

    @property
    def range_m(self) -> float:
        """Distance of the object's centre from the camera."""
        return float(np.linalg.norm(self.code.center))


@dataclass(frozen=True)
class Rejection:
    """Something that was not used: `reason` is a key for counters, `detail` a line for people."""

    reason: str
    detail: str


@dataclass(frozen=True)
class ObservedFrame:
    """All objects of one frame, and a thumbnail of its depth as evidence of free space.

    coarse_depth_m: (h', w') float32, depth sampled on a regular grid over the whole image, 0 = no reading;
        pixel (u', v') of it is pixel ((u' + 0.5) * width / w', (v' + 0.5) * height / h') of the image.
    """

    stamp_ns: int
    observations: tuple[Observation, ...]
    intrinsics: Intrinsics
    coarse_depth_m: np.ndarray
    rejections: tuple[Rejection, ...] = ()


@dataclass(frozen=True)
class OdometrySample:
    """Pose of the camera in the odometry's own drifting frame; only increments between samples are used."""

    stamp_ns: int
    T_odom_camera: Array


class EdgeKind(IntEnum):
    """Where an edge of the pose graph comes from."""

    ODOMETRY = 0
    SHORT_RANGE = 1
    LOOP_CLOSURE = 2
    EXTERNAL = 3


@dataclass(frozen=True)
class Edge:
    """A relative pose between two keyframes: p_from = T_from_to @ p_to; covariance as in neuse.geometry.

    object_ids: the objects it was computed from (empty for odometry).    residual_m: rms of the aligned
    codes.
    """

    from_id: int
    to_id: int
    from_stamp_ns: int
    to_stamp_ns: int
    kind: EdgeKind
    T_from_to: Array
    covariance: Array
    object_ids: tuple[int, ...] = ()
    residual_m: float = 0.0


class MatchStatus(IntEnum):
    """Outcome of data association for one observation (NeuSE IV-B).

    MATCHED: at the place of a known object of this shape.    UNMATCHED: shape known, but no object at this
    place.
    NEW: instantiated as an object in this very frame.    TENTATIVE: no object yet (too far, small or rarely
    seen).
    """

    MATCHED = 0
    UNMATCHED = 1
    NEW = 2
    TENTATIVE = 3


@dataclass(frozen=True)
class TrackedObservation:
    """An observation with the object it belongs to.

    object_id: NO_ID unless MATCHED or NEW.    similar_ids: known objects of like shape, most similar first.
    """

    observation: Observation
    status: MatchStatus
    object_id: int = NO_ID
    similar_ids: tuple[int, ...] = ()


@dataclass(frozen=True)
class Keyframe:
    """A vertex of the pose graph with its latest estimate: p_map = T_map_camera @ p_camera."""

    keyframe_id: int
    stamp_ns: int
    T_map_camera: Array


@dataclass(frozen=True)
class TrackedFrame:
    """A frame with its pose and associated objects; what the mapper is fed.

    keyframe_id: id of this frame in the pose graph, NO_ID when it is no keyframe.
    loop_closed: this frame added a loop closure, so that earlier keyframes have moved.
    edges: edges that this frame added.    odometry_only: no object constrained this pose.
    rejected_edges: how many candidate edges of this frame the gates refused.
    """

    stamp_ns: int
    T_map_camera: Array
    covariance: Array
    observations: tuple[TrackedObservation, ...]
    intrinsics: Intrinsics
    coarse_depth_m: np.ndarray
    keyframe_id: int = NO_ID
    loop_closed: bool = False
    odometry_only: bool = False
    edges: tuple[Edge, ...] = ()
    rejected_edges: int = 0


class ChangeKind(IntEnum):
    """How the scene changed."""

    ADDED = 0
    REMOVED = 1
    MOVED = 2


@dataclass(frozen=True)
class ObjectChange:
    """One change of the scene.

    object_id: the object, under its lasting id.    merged_id: for MOVED, the id under which the tracker had
    met the
    object at its new place (NO_ID otherwise): the tracker must call it object_id from now on.
    T_map_before, T_map_after: p_map = T @ p_object, None where the object was not there.
    """

    stamp_ns: int
    kind: ChangeKind
    object_id: int
    category: str
    T_map_before: Array | None
    T_map_after: Array | None
    merged_id: int = NO_ID


class ObjectStatus(IntEnum):
    """Status of an object in the map."""

    UNCHANGED = 0
    ADDED = 1
    MOVED = 2
    REMOVED = 3


@dataclass(frozen=True)
class MapObject:
    """An object of the map.

    code: latent code in the map frame (average over observations).    T_map_object: pose of the object frame.
    box_size: (3,) full side lengths of the reconstruction's box along the object frame's axes, metres,
    box_center: (3,) its centre in the map frame.
    """

    object_id: int
    category: str
    status: ObjectStatus
    T_map_object: Array
    box_center: Array
    box_size: Array
    code: Code
    first_seen_ns: int
    last_seen_ns: int
    n_observations: int


@dataclass(frozen=True)
class ObjectMap:
    """The map at one instant."""

    stamp_ns: int
    objects: tuple[MapObject, ...] = field(default=())
