"""The front end: a segmented depth image to observed objects, all objects of a category in one forward
pass."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from neuse.embedding.cloud import core
from neuse.embedding.code import Code
from neuse.embedding.embedding import Embedding, load_embedding, shipped_categories
from neuse.errors import InputError
from neuse.params import CheckedParams, param
from neuse.records import Instance, Intrinsics, Observation, ObservedFrame, Rejection, RgbdFrame


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
            embeddings = {category: load_embedding(category) for category in shipped_categories()}
        self.embeddings = dict(embeddings)

    def observe(self, frame: RgbdFrame) -> ObservedFrame:
        """Encode every usable instance.

        Returns:
            The observations in the order of the instances; instances and labels that cannot be used are in
            `rejections`.
        Raises:
            InputError: the frame as a whole cannot be used (sizes, intrinsics, array types).
        """
        check_frame(frame)
        rejections: list[Rejection] = []
        pixels = self._pixels_by_label(frame, rejections)
        found = []
        for instance in frame.instances:
            cloud = self._cloud(frame, instance, pixels.pop(instance.label, None), rejections)
            if cloud is not None:
                found.append((instance, *cloud))
        rejections += [
            Rejection("label_without_instance", f"mask label {label} has no entry in the instances")
            for label in pixels
        ]
        codes = self._encode([(instance.category, points) for instance, points, _ in found])
        observations = [
            self._observation(frame, instance, code, points, rows_cols)
            for (instance, points, rows_cols), code in zip(found, codes, strict=True)
        ]
        usable = [o for o in observations if _is_sound(o, rejections)]
        return ObservedFrame(
            frame.stamp_ns,
            tuple(usable),
            frame.intrinsics,
            coarse_depth(frame.depth_m, self.params.coarse_width, self.params.coarse_height),
            tuple(rejections),
        )

    def _pixels_by_label(self, frame: RgbdFrame, rejections: list[Rejection]) -> dict[int, np.ndarray]:
        """Flat pixel indices of every label in the mask."""
        flat = frame.mask.ravel()
        labelled = np.flatnonzero(flat)
        order = labelled[np.argsort(flat[labelled], kind="stable")]
        labels, starts = np.unique(flat[order], return_index=True)
        pixels = dict(zip(labels.tolist(), np.split(order, starts[1:]), strict=True)) if len(order) else {}
        limit = self.params.max_image_share * flat.size
        for label in [label for label, where in pixels.items() if len(where) > limit or label < 0]:
            share = len(pixels.pop(label)) / flat.size
            rejections.append(Rejection("mask_too_large", f"label {label} covers {share:.0%} of the image"))
            pixels[label] = np.empty(0, dtype=np.int64)
        return pixels

    def _cloud(
        self,
        frame: RgbdFrame,
        instance: Instance,
        pixels: np.ndarray | None,
        rejections: list[Rejection],
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """(n, 3) points of an instance in the camera frame and its flat pixel indices, or a rejection."""
        name = f"instance {instance.label} ({instance.category})"
        if instance.category not in self.embeddings:
            known = ", ".join(self.embeddings)
            rejections.append(Rejection("unknown_category", f"{name}: no weights; known: {known}"))
            return None
        if instance.score < self.params.min_score:
            rejections.append(Rejection("low_score", f"{name}: score {instance.score:.2f}"))
            return None
        if pixels is None:
            rejections.append(Rejection("empty_mask", f"{name}: no pixel of the mask has this label"))
            return None
        if len(pixels) == 0:
            return None  # refused for its size
        points = back_project(frame.depth_m, frame.intrinsics, pixels, self.params.max_range_m)
        points = points[core(points)] if len(points) else points
        if len(points) < self.params.min_points:
            rejections.append(
                Rejection("too_few_points", f"{name}: {len(points)} of {len(pixels)} px have a usable depth")
            )
            return None
        return points, pixels

    def _encode(self, clouds: list[tuple[str, np.ndarray]]) -> list[Code]:
        codes: dict[int, Code] = {}
        for category, embedding in self.embeddings.items():
            own = [i for i, (of, _) in enumerate(clouds) if of == category]
            codes |= zip(own, embedding.encode([clouds[i][1] for i in own]), strict=True)
        return [codes[i] for i in range(len(clouds))]

    def _observation(
        self, frame: RgbdFrame, instance: Instance, code: Code, points: np.ndarray, pixels: np.ndarray
    ) -> Observation:
        height, width = frame.mask.shape
        rows, columns = pixels // width, pixels % width
        border = bool(
            rows.min() == 0 or columns.min() == 0 or rows.max() == height - 1 or columns.max() == width - 1
        )
        kept = np.linspace(0, len(points) - 1, min(self.params.cloud_points, len(points))).astype(int)
        return Observation(
            instance.label,
            instance.score,
            code,
            points[kept].astype(np.float32),
            points.mean(axis=0),
            len(pixels),
            border,
        )


def check_frame(frame: RgbdFrame) -> None:
    """Raises InputError when depth, mask and intrinsics do not fit together."""
    depth, mask, camera = frame.depth_m, frame.mask, frame.intrinsics
    if depth.ndim != 2 or depth.shape != mask.shape:
        raise InputError(
            "size_mismatch", f"depth {depth.shape} and mask {mask.shape} must be images of one size"
        )
    if not np.issubdtype(mask.dtype, np.integer):
        raise InputError("mask_type", f"mask has type {mask.dtype}, expected integer labels")
    if depth.shape != (camera.height, camera.width):
        size = f"{camera.width} x {camera.height}"
        raise InputError(
            "intrinsics_size", f"camera info is for {size}, depth is {depth.shape[1]} x {depth.shape[0]}"
        )
    numbers = [camera.fx, camera.fy, camera.cx, camera.cy]
    if not np.isfinite(numbers).all() or camera.fx <= 0 or camera.fy <= 0:
        raise InputError("intrinsics", f"fx, fy, cx, cy = {numbers}: is the camera calibrated?")
    labels = [instance.label for instance in frame.instances]
    if len(set(labels)) != len(labels):
        raise InputError("duplicate_label", f"instances repeat a label: {sorted(labels)}")


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
    """(height, width) float32 thumbnail of readings (no averages: an average is on no surface); 0 = no
    reading."""
    rows = ((np.arange(height) + 0.5) * depth_m.shape[0] / height).astype(int)
    columns = ((np.arange(width) + 0.5) * depth_m.shape[1] / width).astype(int)
    sampled = depth_m[np.ix_(rows, columns)].astype(np.float32)
    return np.where(np.isfinite(sampled) & (sampled > 0), sampled, np.float32(0))


def _is_sound(observation: Observation, rejections: list[Rejection]) -> bool:
    """Whether the network's answer can be meant for these points."""
    code, reach = observation.code, np.linalg.norm(observation.code.center - observation.partial_center)
    if np.isfinite(code.z).all() and np.isfinite(code.sigmas).all() and reach < 0.5:
        return True
    detail = f"instance {observation.label} ({code.category}): centre {reach:.2f} m from its points"
    rejections.append(Rejection("unsound_code", detail))
    return False
