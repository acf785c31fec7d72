"""The front end: a segmented depth image to observed objects, one forward pass a category."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from neuse.embedding.cloud import core
from neuse.embedding.code import Code
from neuse.embedding.embedding import Embedding, load_embeddings, shipped_categories
from neuse.errors import InputError
from neuse.params import CheckedParams, param
from neuse.records import Instance, Intrinsics, Observation, ObservedFrame, Rejection, RgbdFrame

NO_PIXELS = np.empty(0, dtype=np.int64)


@dataclass(frozen=True)
class ObserverParams(CheckedParams):
    """What counts as an observation."""

    min_points: int = param(40, "an instance needs this many depth readings", 8, 100000)
    min_score: float = param(0.0, "detections below this score are ignored", 0.0, 1.0)
    max_range_m: float = param(6.0, "depth beyond this is ignored", 0.1, 100.0)
    max_image_share: float = param(0.6, "a mask over more of the image than this is no object", 0.01, 1.0)
    cloud_points: int = param(256, "points of the sub-sampled cloud that goes along", 8, 4096)
    coarse_width: int = param(80, "width of the depth thumbnail", 4, 640)
    coarse_height: int = param(60, "height of the depth thumbnail", 4, 480)


class Observer:
    """Turns frames into observed frames with one embedding per category."""

    def __init__(
        self, params: ObserverParams = ObserverParams(), embeddings: Mapping[str, Embedding] | None = None
    ) -> None:
        """`embeddings` by category; None loads all that are shipped."""
        self.params = params
        if embeddings is None:
            embeddings = load_embeddings(shipped_categories())
        self.embeddings = dict(embeddings)

    def observe(self, frame: RgbdFrame, share: float = 1.0) -> ObservedFrame:
        """Encode every usable instance.

        Args:
            share: see `Embedding.encode`; less than 1 where time is short.
        Returns:
            The observations in the order of the instances; instances and labels that cannot be used are in
            `rejections`.
        Raises:
            InputError: the frame as a whole cannot be used (sizes, intrinsics, array types).
        """
        check_frame(frame)
        pixels = pixels_by_label(frame.mask)
        outcomes = [self._seen(frame, i, pixels.pop(i.label, NO_PIXELS)) for i in frame.instances]
        seen = [outcome for outcome in outcomes if isinstance(outcome, _Seen)]
        rejections = [outcome for outcome in outcomes if isinstance(outcome, Rejection)]
        rejections += [
            Rejection("label_without_instance", f"mask label {label} has no entry in the instances")
            for label in pixels
        ]
        codes = self._encode([(s.instance.category, s.points) for s in seen], share)
        observations = [self._observation(frame, s, code) for s, code in zip(seen, codes, strict=True)]
        rejections += [_unsound(o) for o in observations if not _is_sound(o)]
        return ObservedFrame(
            frame.stamp_ns,
            tuple(o for o in observations if _is_sound(o)),
            frame.intrinsics,
            coarse_depth(frame.depth_m, self.params.coarse_width, self.params.coarse_height),
            tuple(rejections),
        )

    def _seen(self, frame: RgbdFrame, instance: Instance, pixels: np.ndarray) -> "_Seen | Rejection":
        """What the frame shows of an instance, or why that is of no use."""
        params, name = self.params, f"instance {instance.label} ({instance.category})"
        if instance.category not in self.embeddings:
            known = ", ".join(self.embeddings)
            return Rejection("unknown_category", f"{name}: no weights; known: {known}")
        if not instance.score >= params.min_score:  # nor is NaN a score
            return Rejection("low_score", f"{name}: score {instance.score:.2f}")
        if instance.score > 1.0:
            return Rejection("score_above_one", f"{name}: score {instance.score:g}; send shares of one")
        if len(pixels) == 0:
            return Rejection("empty_mask", f"{name}: no pixel of the mask has this label")
        if len(pixels) > params.max_image_share * frame.mask.size:
            share = len(pixels) / frame.mask.size
            return Rejection("mask_too_large", f"{name}: covers {share:.0%} of the image")
        points = back_project(frame.depth_m, frame.intrinsics, pixels, params.max_range_m)
        points = points[core(points)] if len(points) else points
        if len(points) < params.min_points:
            detail = f"{name}: {len(points)} of {len(pixels)} px have a usable depth"
            return Rejection("too_few_points", detail)
        return _Seen(instance, points, pixels)

    def _encode(self, clouds: list[tuple[str, np.ndarray]], share: float) -> list[Code]:
        codes: dict[int, Code] = {}
        for category, embedding in self.embeddings.items():
            own = [i for i, (of, _) in enumerate(clouds) if of == category]
            codes |= zip(own, embedding.encode([clouds[i][1] for i in own], share), strict=True)
        return [codes[i] for i in range(len(clouds))]

    def _observation(self, frame: RgbdFrame, seen: "_Seen", code: Code) -> Observation:
        n = len(seen.points)
        kept = np.linspace(0, n - 1, min(self.params.cloud_points, n)).astype(int)
        return Observation(
            seen.instance.label,
            seen.instance.score,
            code,
            seen.points[kept].astype(np.float32),
            seen.points.mean(axis=0),
            len(seen.pixels),
            _touches_border(seen.pixels, frame.mask.shape),
        )


class _Seen(NamedTuple):
    """A usable instance: its points (n, 3), camera frame, metres, and its mask's flat pixel indices."""

    instance: Instance
    points: np.ndarray
    pixels: np.ndarray


def check_frame(frame: RgbdFrame) -> None:
    """Raises InputError when depth, mask and intrinsics do not fit together."""
    depth, mask, camera = frame.depth_m, frame.mask, frame.intrinsics
    if depth.ndim != 2 or depth.shape != mask.shape:
        raise InputError(
            "size_mismatch", f"depth {depth.shape} and mask {mask.shape} must be images of one size"
        )
    if not np.issubdtype(depth.dtype, np.floating):
        raise InputError("depth_type", f"depth has type {depth.dtype}, expected floating point metres")
    if not np.issubdtype(mask.dtype, np.integer):
        raise InputError("mask_type", f"mask has type {mask.dtype}, expected integer labels")
    if depth.shape != (camera.height, camera.width):
        size = f"{camera.width} x {camera.height}"
        raise InputError(
            "intrinsics_size", f"camera info is for {size}, depth is {depth.shape[1]} x {depth.shape[0]}"
        )
    numbers = [camera.fx, camera.fy, camera.cx, camera.cy]
    if not camera.is_sound:
        raise InputError("intrinsics", f"fx, fy, cx, cy = {numbers}: is the camera calibrated?")
    labels = [instance.label for instance in frame.instances]
    if len(set(labels)) != len(labels):
        raise InputError("duplicate_label", f"instances repeat a label: {sorted(labels)}")


def pixels_by_label(mask: np.ndarray) -> dict[int, np.ndarray]:
    """Flat pixel indices of every label in the mask but the background."""
    flat = mask.ravel()
    labelled = np.flatnonzero(flat != 0)  # numbers it would count a second time, and slowly
    order = np.argsort(flat[labelled], kind="stable")
    labels, starts = np.unique(flat[labelled[order]], return_index=True)
    return dict(zip(labels.tolist(), np.split(labelled[order], starts)[1:], strict=True))


def back_project(
    depth_m: np.ndarray, intrinsics: Intrinsics, pixels: np.ndarray, max_range_m: float
) -> np.ndarray:
    """(n, 3) float64 camera-frame points of flat pixel indices that have a depth in (0, max_range_m]."""
    z = depth_m.ravel()[pixels].astype(np.float64)
    usable = (z > 0) & (z <= max_range_m)  # NaN and infinity compare false or are too far
    z, pixels = z[usable], pixels[usable]
    v, u = np.divmod(pixels, intrinsics.width)
    return np.stack([(u - intrinsics.cx) / intrinsics.fx * z, (v - intrinsics.cy) / intrinsics.fy * z, z], -1)


def coarse_depth(depth_m: np.ndarray, width: int, height: int) -> np.ndarray:
    """(height, width) float32 thumbnail of single readings, since a mean is on no surface; 0 = none."""
    rows = ((np.arange(height) + 0.5) * depth_m.shape[0] / height).astype(int)
    columns = ((np.arange(width) + 0.5) * depth_m.shape[1] / width).astype(int)
    sampled = depth_m[np.ix_(rows, columns)].astype(np.float32)
    return np.where(np.isfinite(sampled) & (sampled > 0), sampled, np.float32(0))


def _touches_border(pixels: np.ndarray, shape: tuple[int, ...]) -> bool:
    rows, columns = np.divmod(pixels, shape[1])
    return bool(
        rows.min() == 0 or columns.min() == 0 or rows.max() == shape[0] - 1 or columns.max() == shape[1] - 1
    )


def _is_sound(observation: Observation) -> bool:
    """Whether the network's answer can be meant for these points."""
    code = observation.code
    return bool(np.isfinite(code.z).all() and np.isfinite(code.sigmas).all()) and _offset_m(observation) < 0.5


def _unsound(observation: Observation) -> Rejection:
    name = f"instance {observation.label} ({observation.code.category})"
    detail = f"{name}: centre {_offset_m(observation):.2f} m from its points"
    return Rejection("unsound_code", detail)


def _offset_m(observation: Observation) -> float:
    return float(np.linalg.norm(observation.code.center - observation.partial_center))
