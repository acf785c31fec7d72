"""Is the unit of depth right? Objects tell: through the wrong unit they come out as grains or as houses."""

from typing import NamedTuple

import numpy as np

from neuse.records import RgbdFrame

# Least and largest apparent size, metres: of what is seen of one, down to a tenth of a small one.
SIZES_M = {"mug": (0.03, 0.25), "bottle": (0.03, 0.3), "bowl": (0.03, 0.35), "box": (0.025, 0.4)}
ANY_SIZE_M = (0.025, 3.0)
FACTORS = (1e-3, 1e-2, 0.1, 0.2, 5.0, 10.0, 100.0, 1e3)  # between the units that cameras have


class UnitFault(NamedTuple):
    """What is wrong with the unit, and about which factor the depths are to be multiplied by."""

    text: str
    factor: float


class ScaleCheck:
    """Collects how large the segmented objects of some frames appear."""

    def __init__(self) -> None:
        self._seen: list[tuple[str, float]] = []  # category, apparent size

    def add(self, frame: RgbdFrame) -> None:
        """Take in the objects of one frame, but for those that its border cuts off."""
        for instance in frame.instances:
            size_m = apparent_size_m(frame, instance.label)
            if size_m is not None and not _is_cut_off(frame.mask == instance.label):
                self._seen.append((instance.category, size_m))

    def fault(self) -> UnitFault | None:
        """What is wrong with the unit where most objects are too small, or most too large; else None."""
        small, large = ([seen for seen in self._seen if _side(*seen) == side] for side in (-1, 1))
        odd = max(small, large, key=len)
        if 2 * len(odd) <= len(self._seen):
            return None
        size_m = np.median([size_m for _, size_m in odd])
        usual_m = np.median([np.sqrt(np.prod(SIZES_M.get(category, ANY_SIZE_M))) for category, _ in odd])
        factor = min(FACTORS, key=lambda one: abs(np.log(size_m * one / usual_m)))
        names = ", ".join(sorted({category for category, _ in odd}))
        told = f"the unit of depth is wrong: objects come out {size_m:.2g} m large ({names})"
        return UnitFault(f"{told}, about {factor:g} times of which is usual", factor)


def _side(category: str, size_m: float) -> int:
    """-1: too small for what it is, 1: too large, 0: neither."""
    least_m, most_m = SIZES_M.get(category, ANY_SIZE_M)
    return int(size_m > most_m) - int(size_m < least_m)


def _is_cut_off(inside: np.ndarray) -> bool:
    return bool(inside[[0, -1]].any() or inside[:, [0, -1]].any())


def apparent_size_m(frame: RgbdFrame, label: int) -> float | None:
    """Side of a square as large as an object's visible part, metres; None where depth says nothing of it."""
    inside = frame.mask == label
    depth_m = frame.depth_m[inside]
    depth_m = depth_m[np.isfinite(depth_m) & (depth_m > 0)]
    focal_px = np.sqrt(frame.intrinsics.fx * frame.intrinsics.fy)
    return float(np.sqrt(inside.sum()) / focal_px * np.median(depth_m)) if len(depth_m) else None
