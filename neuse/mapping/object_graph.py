"""Object graphs: the layout of one frame's objects beside the map's, compared by oriented edges (NeuSE IV-D).

An edge points from an anchor to an object. Edges survive the drift of the camera, because a frame's objects
drift together; so do places that are looked up relative to the anchors around them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuse.geometry import Array, make_transform, transform_points
from neuse.params import CheckedParams, param


@dataclass(frozen=True)
class LayoutParams(CheckedParams):
    """How layouts are compared."""

    delta_e_m: float = param(
        0.03, "edges that differ by at most this agree (delta_e of NeuSE eq. 10)", 0.001, 1.0
    )
    anchor_radius_m: float = param(1.5, "objects this near to a place serve as its anchors", 0.1, 100.0)
    far_anchor_radius_m: float = param(
        3.5, "objects this near serve where those nearer do not suffice, metres", 0.1, 100.0
    )
    met_together_frames: int = param(
        30, "objects met within so many frames, known ones being in sight, were met together", 0, 100000
    )
    carried_frames: int = param(
        60, "anchors seen so many frames before still tie a view that has none itself", 0, 100000
    )
    rotation_prior_m: float = param(
        0.5,
        "lever arm with which the pose estimate's own rotation is held against that of the anchors",
        0.0,
        10.0,
    )


@dataclass(frozen=True)
class Anchor:
    """A matched object: its centre as observed through the frame's pose, and as the map has it.

    observed, reference: (3,) map frame, metres.    since_tick: step since when it has been there.
    """

    object_id: int
    observed: Array
    reference: Array
    since_tick: int


def align_graphs(anchors: Sequence[Anchor], params: LayoutParams) -> Array | None:
    """Drift of a frame near its anchors: p_reference = T_reference_observed @ p_observed, both map frame.

    None if fewer than two votes agree on it; each anchor has a vote, and so has the pose estimate (no drift).
    """
    if not anchors:
        return None
    observed = np.stack([anchor.observed for anchor in anchors])
    reference = np.stack([anchor.reference for anchor in anchors])
    T_reference_observed = _fit(observed, reference, params.rotation_prior_m)
    residuals_m = np.linalg.norm(transform_points(T_reference_observed, observed) - reference, axis=1)
    drift_m = np.linalg.norm(transform_points(T_reference_observed, observed) - observed, axis=1).min()
    votes = int((residuals_m <= params.delta_e_m).sum()) + int(drift_m <= params.delta_e_m)
    return T_reference_observed if votes >= 2 else None


def _fit(observed: Array, reference: Array, rotation_prior_m: float) -> Array:
    """Horn's rotation with a prior on none, then the median shift, which one wrong anchor hardly moves."""
    correlation = (reference - reference.mean(axis=0)).T @ (observed - observed.mean(axis=0))
    U, _, Vt = np.linalg.svd(correlation + rotation_prior_m**2 * np.eye(3))
    R = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    return make_transform(R, np.median(reference - observed @ R.T, axis=0))


def is_unchanged(
    center: Array, known_center: Array, anchors: Sequence[Anchor], params: LayoutParams
) -> bool | None:
    """Whether an observed object is where a known one is, seen from the anchors (NeuSE eq. 10).

    center: (3,) as observed through the frame's pose.    known_center: (3,) of the known object; map frame.
    Returns:
        True if at least one pair of edges agrees within delta_e, None without trustworthy anchors.
    """
    T_reference_observed = align_graphs(anchors, params)
    if T_reference_observed is None:
        return None
    R = T_reference_observed[:3, :3]
    edges = (center - np.stack([anchor.observed for anchor in anchors])) @ R.T
    known_edges = known_center - np.stack([anchor.reference for anchor in anchors])
    return bool((np.linalg.norm(edges - known_edges, axis=1) <= params.delta_e_m).any())
