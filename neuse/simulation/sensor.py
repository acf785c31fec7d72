"""Faults of a structured-light or stereo depth sensor and of a segmenter, applied to a perfect rendering.

All of it works on whole images and on crops alike, and costs about 10 ms for 640 x 480.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from neuse.params import CheckedParams, param


@dataclass(frozen=True)
class SensorFaults(CheckedParams):
    """Faults, all off by default; `ideal`, `nominal` and `real` are the sets in use."""

    noise_m_at_1m: float = param(
        0.0, "standard deviation of depth at 1 m, growing with range squared", 0.0, 0.1
    )
    noise_grain_px: int = param(
        1, "side of the square over which depth noise is averaged (stereo matching)", 1, 31
    )
    max_range_m: float = param(np.inf, "no reading beyond", 0.1)
    quantisation_m: float = param(0.0, "depth step, 0 for none", 0.0, 0.1)
    baseline_px_m: float = param(
        0.0, "focal length times stereo baseline: no reading where the second imager is occluded", 0.0, 1000.0
    )
    hole_rate: float = param(0.0, "patches without reading per 10 000 px", 0.0, 100.0)
    hole_radius_px: float = param(4.0, "largest radius of such a patch", 1.0, 100.0)
    edge_jump: float = param(0.03, "a depth edge is a jump by this share of the depth", 0.0, 1.0)
    flying_rate: float = param(0.0, "share of depth edges with a pixel between the surfaces", 0.0, 1.0)
    edge_hole_rate: float = param(0.0, "share of depth edges without reading", 0.0, 1.0)
    erosion_px: int = param(0, "a mask shrinks by up to this", 0, 20)
    dilation_px: int = param(0, "a mask grows by up to this", 0, 20)
    cut_rate: float = param(0.0, "share of masks that lose a part", 0.0, 1.0)
    cut_share: float = param(0.3, "largest share of its extent that a cut mask loses", 0.0, 1.0)
    merge_rate: float = param(0.0, "share of touching pairs of masks that become one", 0.0, 1.0)
    miss_rate: float = param(0.0, "share of masks that are not there", 0.0, 1.0)
    min_mask_px: int = param(0, "smaller masks are not there", 0, 1_000_000)


def ideal() -> SensorFaults:
    """No faults."""
    return SensorFaults()


def nominal() -> SensorFaults:
    """Depth noise alone: 1.5 mm at 1 m, 13.5 mm at 3 m, in whole millimetres; no masks of a few pixels."""
    return SensorFaults(noise_m_at_1m=0.0015, quantisation_m=0.001, min_mask_px=50)


def real() -> SensorFaults:
    """All faults of a stereo camera (RealSense D435 at 640 x 480: 50 mm x 615 px) and a learned segmenter.

    A disparity error of 0.05 px is 1.6 mm at 1 m; matching over a window makes it smooth over a few pixels.
    """
    return SensorFaults(
        noise_m_at_1m=0.0016,
        noise_grain_px=3,
        max_range_m=10.0,
        quantisation_m=0.001,
        baseline_px_m=30.75,
        hole_rate=0.25,
        flying_rate=0.3,
        edge_hole_rate=0.15,
        erosion_px=2,
        dilation_px=1,
        cut_rate=0.05,
        merge_rate=0.1,
        miss_rate=0.03,
        min_mask_px=150,
    )


def apply_faults(
    depth_m: np.ndarray, label: np.ndarray, faults: SensorFaults, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """What a faulty sensor and segmenter give for a perfect image.

    Args:
        depth_m: (h, w) float32, metres, 0 = no surface.    label: (h, w) integer instances, 0 = background.
    Returns:
        depth_m (h, w) float32 with 0 = no reading, and the mask (h, w) int32: instances keep their labels,
        merged ones that of the larger.
    """
    return faulty_depth(depth_m, faults, rng), faulty_mask(label, faults, rng)


def faulty_depth(depth_m: np.ndarray, faults: SensorFaults, rng: np.random.Generator) -> np.ndarray:
    """(h, w) float32 depth with edge, noise, quantisation and hole faults."""
    missing = _stereo_shadow(depth_m, faults.baseline_px_m) | (depth_m > faults.max_range_m)
    missing |= _patches(depth_m.shape, faults, rng)
    measured = _with_faulty_edges(depth_m, faults, rng)
    if faults.noise_m_at_1m > 0.0:
        measured += faults.noise_m_at_1m * measured**2 * _noise(depth_m.shape, faults.noise_grain_px, rng)
    if faults.quantisation_m > 0.0:
        step = np.float32(faults.quantisation_m)
        measured = np.round(measured / step) * step
    measured[missing] = 0.0
    return np.maximum(measured, 0.0)


def _noise(shape: tuple[int, ...], grain_px: int, rng: np.random.Generator) -> np.ndarray:
    """(h, w) float32 normal noise of unit variance, correlated over `grain_px`."""
    white = rng.standard_normal(shape, dtype=np.float32)
    return white if grain_px == 1 else ndimage.uniform_filter(white, grain_px) * np.float32(grain_px)


def _stereo_shadow(depth_m: np.ndarray, baseline_px_m: float) -> np.ndarray:
    """(h, w) bool: the second imager, to the right of the first, sees something nearer in that direction.

    Pixel u appears in the second image at u - disparity; one that appears further left hides all to its left.
    """
    if baseline_px_m == 0.0:
        return np.zeros(depth_m.shape, dtype=bool)
    disparity = np.zeros_like(depth_m)
    np.divide(np.float32(baseline_px_m), depth_m, out=disparity, where=depth_m > 0.0)
    u_second = np.arange(depth_m.shape[1], dtype=np.float32) - disparity
    leftmost = np.minimum.accumulate(u_second[:, ::-1], axis=1)[:, ::-1]
    return u_second > leftmost + 0.5


def _patches(shape: tuple[int, ...], faults: SensorFaults, rng: np.random.Generator) -> np.ndarray:
    """(h, w) bool: ellipses without reading, as shiny and dark spots leave."""
    missing = np.zeros(shape, dtype=bool)
    for _ in range(rng.poisson(faults.hole_rate * missing.size / 1e4)):
        v, u = rng.uniform((0, 0), shape)
        radius_v, radius_u = rng.uniform(1.0, faults.hole_radius_px, 2)
        v0, u0 = max(int(v - radius_v), 0), max(int(u - radius_u), 0)
        box = missing[v0 : int(v + radius_v) + 1, u0 : int(u + radius_u) + 1]
        rows, columns = np.ogrid[v0 : v0 + box.shape[0], u0 : u0 + box.shape[1]]
        box |= ((rows - v) / radius_v) ** 2 + ((columns - u) / radius_u) ** 2 <= 1.0
    return missing


def _with_faulty_edges(depth_m: np.ndarray, faults: SensorFaults, rng: np.random.Generator) -> np.ndarray:
    """A copy with flying pixels and holes where neighbouring pixels (right, below) see different surfaces."""
    flat = depth_m.ravel()
    measured = flat.copy()
    for axis, step in ((1, 1), (0, depth_m.shape[1])):
        first = _edges(depth_m, axis, faults.edge_jump)
        for share, flying in ((faults.flying_rate, True), (faults.edge_hole_rate, False)):
            chosen = first[rng.random(len(first)) < share]
            victim = chosen + step * rng.integers(0, 2, len(chosen))
            weight = rng.random(len(chosen), dtype=np.float32)
            measured[victim] = weight * flat[chosen] + (1 - weight) * flat[chosen + step] if flying else 0.0
    return measured.reshape(depth_m.shape)


def _edges(depth_m: np.ndarray, axis: int, jump: float) -> np.ndarray:
    """Flat indices of pixels whose next neighbour along `axis` is on another surface; both have a depth."""
    near, far = (depth_m[:, :-1], depth_m[:, 1:]) if axis == 1 else (depth_m[:-1], depth_m[1:])
    lower = np.minimum(near, far)
    is_edge = np.zeros(depth_m.shape, dtype=bool)
    is_edge[: near.shape[0], : near.shape[1]] = (np.abs(far - near) > jump * lower) & (lower > 0.0)
    return np.flatnonzero(is_edge)


def faulty_mask(label: np.ndarray, faults: SensorFaults, rng: np.random.Generator) -> np.ndarray:
    """(h, w) int32 mask with missed, resized, cut and merged instances."""
    mask = label.astype(np.int32)
    boxes = [(index + 1, box) for index, box in enumerate(ndimage.find_objects(mask)) if box is not None]
    for instance, box in boxes:
        _resize(mask, instance, _grown(box, 1 + faults.dilation_px), faults, rng)
        if rng.random() < faults.cut_rate:
            _cut(mask[box], instance, rng.uniform(0.0, faults.cut_share), rng)
    if faults.merge_rate > 0.0:
        _merge(mask, boxes, faults.merge_rate, rng)
    missed = rng.random(mask.max() + 1) < faults.miss_rate
    missed |= np.bincount(mask.ravel()) < faults.min_mask_px
    return np.where(missed[mask], 0, mask)


def _grown(box: tuple[slice, slice], margin_px: int) -> tuple[slice, slice]:
    rows, columns = (slice(max(side.start - margin_px, 0), side.stop + margin_px) for side in box)
    return rows, columns


def _resize(
    mask: np.ndarray, instance: int, box: tuple[slice, slice], faults: SensorFaults, rng: np.random.Generator
) -> None:
    """Erode or dilate one instance in place by a random amount; it grows over the background only."""
    change_px = int(rng.integers(-faults.erosion_px, faults.dilation_px + 1))
    region = mask[box]
    own = region == instance
    if change_px > 0:
        region[ndimage.binary_dilation(own, iterations=change_px) & (region == 0)] = instance
    elif change_px < 0:
        region[own & ~ndimage.binary_erosion(own, iterations=-change_px, border_value=1)] = 0


def _cut(region: np.ndarray, instance: int, share: float, rng: np.random.Generator) -> None:
    """Remove the outer `share` of an instance's extent, in a random direction, in place."""
    own = np.argwhere(region == instance)
    if len(own) == 0:
        return
    angle = rng.uniform(0.0, 2.0 * np.pi)
    along = own @ [np.sin(angle), np.cos(angle)]
    lost = own[along > along.max() - share * np.ptp(along)]
    region[lost[:, 0], lost[:, 1]] = 0


def _merge(
    mask: np.ndarray, boxes: list[tuple[int, tuple[slice, slice]]], rate: float, rng: np.random.Generator
) -> None:
    """Give both instances of some touching pairs the label of the larger one, in place."""
    for instance, box in boxes:
        region = mask[_grown(box, 2)]
        own = region == instance
        if not own.any():
            continue
        around = region[ndimage.binary_dilation(own, iterations=2) & ~own]
        for neighbour in np.unique(around[around > instance]):
            if rng.random() < rate:
                smaller_first = np.argsort([np.sum(mask == instance), np.sum(mask == neighbour)])
                smaller, larger = np.array([instance, neighbour])[smaller_first]
                mask[mask == smaller] = larger
