"""TUM RGB-D: rgb.txt and depth.txt with lines `stamp_s picture`, as from the benchmark's tools.

camera.json        {"width", "height", "fx", "fy", "cx", "cy"} of the depth pictures;
                   optional: "depth_scale", millimetres of one unit (0.2: factor 5000)
depth.txt          the frames; each is paired with the colour picture nearest in time, at most 20 ms away
rgb.txt            may be missing
groundtruth.txt    optional: poses of the camera, lines `stamp_s x y z qx qy qz qw`
odometry.txt       optional: the same, from an odometry
masks/NAME.png     8 or 16 bit, 0 = background, else an instance; NAME is that of the colour picture, or of
                   the depth picture where there is no colour
masks/instances.json  what the labels are: {"1": "mug", "2": "bottle"}, or for each picture of its own
                   {"NAME": {"1": "mug"}, ...}
"""

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from neuse.errors import InputError
from neuse.records import Instance, Intrinsics, RgbdFrame
from neuse_bags.pictures import (
    DEPTH_KINDS,
    MASK_KINDS,
    FrameSource,
    Trajectories,
    intrinsics_from,
    make_instance,
    read_color,
    read_json,
    read_picture,
)
from neuse_bags.trajectory_files import read_lines, read_poses, seconds_to_ns

MARK = "depth.txt"
TOLERANCE_NS = 20_000_000
MM_PER_UNIT = 0.2
CAMERA_EXAMPLE = '{"width": 640, "height": 480, "fx": 525, "fy": 525, "cx": 319.5, "cy": 239.5}'
INSTANCES_EXAMPLE = '{"1": "mug", "2": "bottle"}, the category of each label of the masks'
Listing = list[tuple[int, str]]
Pairs = tuple[tuple[int, str, str | None], ...]  # stamp_ns, depth picture, colour picture or None


@dataclass(frozen=True)
class TumFolder:
    """Depth pictures paired with colour pictures, and what the labels of the masks are."""

    path: Path
    intrinsics: Intrinsics
    depth_scale_m: float
    pairs: Pairs
    labels: dict[str, Any]
    skipped: list[InputError] = field(default_factory=list)

    def frames(self) -> Iterator[RgbdFrame]:
        """The frames, one by one.

        Raises:
            InputError: a picture is missing, unreadable, or of another size than the camera's.
        """
        for stamp_ns, depth, color in self.pairs:
            yield self._frame(stamp_ns, depth, color)

    def _frame(self, stamp_ns: int, depth: str, color: str | None) -> RgbdFrame:
        name = Path(color or depth).stem
        pixels = self._picture(depth, DEPTH_KINDS, "depth.txt")
        return RgbdFrame(
            stamp_ns=stamp_ns,
            depth_m=(pixels * self.depth_scale_m).astype(np.float32),
            mask=self._picture(f"masks/{name}.png", MASK_KINDS, "rgb.txt" if color else "depth.txt"),
            instances=_instances(self.labels, name, self.path),
            intrinsics=self.intrinsics,
            color=None
            if color is None
            else read_color(self.path / color, self._size, "rgb.txt", self.skipped),
        )

    def _picture(self, name: str, kinds: tuple[type, ...], asked_by: str) -> np.ndarray:
        return read_picture(self.path / name, self._size, kinds, asked_by)

    @property
    def _size(self) -> tuple[int, int]:
        return self.intrinsics.width, self.intrinsics.height


def open_tum(path: Path) -> FrameSource:
    """Read and check the lists, the camera, the labels and the trajectories.

    Raises:
        InputError: a file is missing or wrong, or the stamps of the lists do not pair.
    """
    camera_json = path / "camera.json"
    camera = read_json(camera_json, CAMERA_EXAMPLE)
    intrinsics, scale_m = intrinsics_from(camera, camera_json), _scale_m(camera, camera_json)
    depth, colors = _listing(path / MARK), path / "rgb.txt"
    pairs = _paired(depth, _listing(colors), path) if colors.exists() else _alone(depth)
    labels = read_json(path / "masks" / "instances.json", INSTANCES_EXAMPLE)
    folder = TumFolder(path, intrinsics, scale_m, pairs, labels)
    stamps_ns = [stamp_ns for stamp_ns, _, _ in pairs]
    odometry, truth = (read_poses(path / name, stamps_ns) for name in ("odometry.txt", "groundtruth.txt"))
    left_out = f"{len(depth) - len(pairs)} depth pictures without a colour picture at their time are left out"
    return FrameSource(
        n_frames=len(pairs),
        frames=folder.frames,
        trajectories=Trajectories(odometry, truth),
        unit_hint=partial(_unit_hint, camera_json, scale_m * 1e3),
        label_hint=_label_hint(path / "masks" / "instances.json", labels, pairs),
        notes=(left_out,) if len(pairs) < len(depth) else (),
        skipped=folder.skipped,
    )


def _unit_hint(file: Path, scale_mm: float, factor: float) -> str:
    told = f"write about {scale_mm * factor:g} as depth_scale (now {scale_mm:g})"
    return f"{told}, the millimetres of one unit, in {file}"


def _label_hint(file: Path, labels: dict[str, Any], pairs: Pairs) -> str:
    _, depth, color = pairs[0]
    example = f'{{"{Path(color or depth).stem}": {{"1": "mug"}}, ...}}'
    return f"write into {file} {example if _is_nested(labels) else INSTANCES_EXAMPLE}"


def _is_nested(labels: dict[str, Any]) -> bool:
    return any(isinstance(value, dict) for value in labels.values())


def _alone(depth: Listing) -> Pairs:
    return tuple((stamp_ns, name, None) for stamp_ns, name in depth)


def _scale_m(camera: dict[str, Any], path: Path) -> float:
    scale_mm = camera.get("depth_scale", MM_PER_UNIT)
    if not isinstance(scale_mm, float | int) or not 0 < scale_mm < np.inf:
        raise InputError("camera", f"{path} has depth_scale {scale_mm!r}; write the millimetres of one unit")
    return scale_mm * 1e-3


def _listing(path: Path) -> Listing:
    """(stamp_ns, picture) of each line, in the order of their stamps."""
    lines = read_lines(path)
    if not lines or any(len(words) != 2 for words in lines):
        raise InputError("tum", f"{path} is not `stamp_s picture` a line; write one line a picture")
    return sorted((seconds_to_ns(stamp, path), name) for stamp, name in lines)


def _paired(depth: Listing, colors: Listing, path: Path) -> Pairs:
    """Each depth picture with the colour picture nearest in time; those without are left out, if few."""
    color_ns = [stamp_ns for stamp_ns, _ in colors]
    nearest = [_nearest(color_ns, stamp_ns) for stamp_ns, _ in depth]
    apart_ns = [abs(color_ns[i] - stamp_ns) for i, (stamp_ns, _) in zip(nearest, depth, strict=True)]
    pairs = tuple(
        (stamp_ns, name, colors[i][1])
        for (stamp_ns, name), i, away_ns in zip(depth, nearest, apart_ns, strict=True)
        if away_ns <= TOLERANCE_NS
    )
    if 2 * len(pairs) < len(depth):
        found = f"only {len(pairs)} of {len(depth)} stamps of {path / MARK} are in {path / 'rgb.txt'}"
        away = f"the others are {np.median(apart_ns) / 1e6:.0f} ms away from the next"
        raise InputError("unpaired_stamps", f"{found}, {away}; write both in one clock, or leave out rgb.txt")
    return pairs


def _nearest(stamps_ns: Sequence[int], stamp_ns: int) -> int:
    """Index of the nearest of ascending stamps."""
    after = bisect_left(stamps_ns, stamp_ns)
    around = range(max(after - 1, 0), min(after + 1, len(stamps_ns)))
    return min(around, key=lambda index: abs(stamps_ns[index] - stamp_ns))


def _instances(labels: dict[str, Any], name: str, path: Path) -> tuple[Instance, ...]:
    """What the labels of one mask are."""
    file = path / "masks" / "instances.json"
    own = labels.get(name, {}) if _is_nested(labels) else labels
    if not isinstance(own, dict):
        raise InputError("instances", f"{file} has no labels for {name}; write {INSTANCES_EXAMPLE}")
    return tuple(
        make_instance(label, category, 1.0, file, INSTANCES_EXAMPLE) for label, category in own.items()
    )
