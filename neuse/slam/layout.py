"""Whether possible matches of a frame agree with each other: equal distances, angles and directions."""

from dataclasses import dataclass

import numpy as np

from neuse.embedding.code import Code
from neuse.geometry import Array
from neuse.slam.object_frames import ObjectFrames
from neuse.slam.track import Track


@dataclass(frozen=True)
class View:
    """The usable observations of one frame, reduced.

    alike: objects of the map that may be alike in shape to one of these, wherever they stand or stood.
    rivals: of each the known object, if any, that it is if it is not the one whose place it is in.
    """

    codes: tuple[Code, ...]
    frames: ObjectFrames
    partial_centers: Array
    alike: tuple[Track, ...]
    rivals: tuple[Track | None, ...]

    def __len__(self) -> int:
        return len(self.codes)


@dataclass(frozen=True)
class Pairs:
    """p possible matches: observation `rows`, track `columns`, the place gates (m) and weights of each."""

    rows: np.ndarray
    columns: np.ndarray
    gates_m: Array
    weights: Array

    def only(self, chosen: np.ndarray) -> "Pairs":
        """Those of a mask."""
        return Pairs(self.rows[chosen], self.columns[chosen], self.gates_m[chosen], self.weights[chosen])


def same_layout(
    view: View, places: Array, pairs: Pairs, tolerance_m: float, tolerance_rad: float
) -> np.ndarray:
    """(p, p) whether two pairs have equal distance and equal angle of axes, if told, here and in the map."""
    i, m = pairs.rows, pairs.columns
    here, there = view.frames.centers[i], places[0][m]
    distances_here = np.linalg.norm(here[:, None] - here[None], axis=-1)
    distances_there = np.linalg.norm(there[:, None] - there[None], axis=-1)
    variances = view.frames.variances[0][i]
    tolerances_m = tolerance_m + np.sqrt(variances[:, None] + variances[None])
    angles_here = angles_between(view.frames.axes[i])
    angles_there = angles_between(places[1][m])
    told = view.frames.tell_axes[i]
    return (
        (np.abs(distances_here - distances_there) <= tolerances_m)
        & ((np.abs(angles_here - angles_there) <= tolerance_rad) | ~told[:, None] | ~told[None])
        & (i[:, None] != i[None])
        & (m[:, None] != m[None])
    )


def same_directions(
    view: View,
    places: Array,
    pairs: Pairs,
    T_map_camera: Array,
    turns_rad: Array,
    tolerance_m: float,
) -> np.ndarray:
    """(p, p) whether two pairs lie in equal directions, for an attitude known within turns_rad (p,)."""
    here = view.frames.centers[pairs.rows] @ T_map_camera[:3, :3].T
    there = places[0][pairs.columns]
    between_here, between_there = here[:, None] - here[None], there[:, None] - there[None]
    turns = np.maximum(turns_rad[:, None], turns_rad[None])
    tolerances_m = 2 * tolerance_m + turns * np.linalg.norm(between_there, axis=-1)
    return np.linalg.norm(between_here - between_there, axis=-1) <= tolerances_m


def angles_between(vectors: Array) -> Array:
    return np.arccos(np.clip(vectors @ vectors.T, -1.0, 1.0))
