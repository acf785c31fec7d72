"""Is the unit of depth right? Objects tell: through the wrong unit they come out as grains or as houses."""

import numpy as np

from neuse.records import RgbdFrame

LEAST_M, MOST_M = 0.025, 3.0


class ScaleCheck:
    """Collects how large the segmented objects of some frames appear."""

    def __init__(self) -> None:
        self._sizes_m: list[float] = []

    def add(self, frame: RgbdFrame) -> None:
        """Take in the objects of one frame."""
        sizes_m = (apparent_size_m(frame, instance.label) for instance in frame.instances)
        self._sizes_m += [size_m for size_m in sizes_m if size_m is not None]

    def fault(self) -> str | None:
        """What is wrong with the unit, None where it can be right."""
        size_m = float(np.median(self._sizes_m)) if self._sizes_m else LEAST_M
        if LEAST_M <= size_m <= MOST_M:
            return None
        return f"the unit of depth is wrong: objects come out {size_m:.2g} m large"


def apparent_size_m(frame: RgbdFrame, label: int) -> float | None:
    """Side of a square as large as an object's visible part, metres; None where depth says nothing of it."""
    inside = frame.mask == label
    depth_m = frame.depth_m[inside]
    depth_m = depth_m[np.isfinite(depth_m) & (depth_m > 0)]
    focal_px = np.sqrt(frame.intrinsics.fx * frame.intrinsics.fy)
    return float(np.sqrt(inside.sum()) / focal_px * np.median(depth_m)) if len(depth_m) else None
