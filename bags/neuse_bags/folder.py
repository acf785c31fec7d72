"""Plain folder: colour, depth and mask PNGs with frames.json.

frames.json        {"intrinsics": {"width", "height", "fx", "fy", "cx", "cy"},
                    "frames": [{"frame": 0, "instances": [{"id": 1, "category": "mug"}, ...]}, ...]}
                   optional: "rate_hz" (10), "depth_scale_m" (0.001); in a frame "stamp_s"
                   (frame / rate_hz), in an instance "score" (1)
00_depth.png       16 bit, in units of depth_scale_m, 0 = no reading; 00 is the frame, at least two digits
00_mask.png        8 or 16 bit, 0 = background, else the id of an instance
00_color.png       8 bit, may be missing
odometry.tum       optional: poses of the camera, lines `stamp_s x y z qx qy qz qw`
ground_truth.tum   optional: the same, for the evaluation only
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
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
    what_is_wrong,
)
from neuse_bags.trajectory_files import LATEST_NS, read_poses

MARK = "frames.json"
FIRST_STAMP_NS = 10**9  # a stamp of zero means "no time" to ROS
CAMERA_EXAMPLE = '"intrinsics": {"width": 640, "height": 480, "fx": 600, "fy": 600, "cx": 320, "cy": 240}'
FRAME_EXAMPLE = '{"frame": 0, "instances": [{"id": 1, "category": "mug"}]}'


@dataclass(frozen=True)
class FrameEntry:
    """A frame as frames.json has it; its instances are looked at when it is made."""

    number: int
    stamp_ns: int
    instances: tuple[Any, ...]


@dataclass(frozen=True)
class PictureFolder:
    """A checked frames.json and where its pictures lie."""

    path: Path
    intrinsics: Intrinsics
    entries: tuple[FrameEntry, ...]
    depth_scale_m: float
    skipped: list[InputError] = field(default_factory=list)

    def frames(self) -> Iterator[RgbdFrame]:
        """The frames, one by one.

        Raises:
            InputError: a picture is missing, unreadable, or of another size than the camera's.
        """
        for entry in self.entries:
            yield self._frame(entry)

    def _frame(self, entry: FrameEntry) -> RgbdFrame:
        stem = f"{entry.number:02d}"
        depth = self._picture(f"{stem}_depth.png", DEPTH_KINDS)
        color = self.path / f"{stem}_color.png"
        return RgbdFrame(
            stamp_ns=entry.stamp_ns,
            depth_m=(depth * self.depth_scale_m).astype(np.float32),
            mask=self._picture(f"{stem}_mask.png", MASK_KINDS),
            instances=tuple(_instance(item, stem, self.path / MARK) for item in entry.instances),
            intrinsics=self.intrinsics,
            color=read_color(color, self._size, MARK, self.skipped) if color.exists() else None,
        )

    def _picture(self, name: str, kinds: tuple[type, ...]) -> np.ndarray:
        return read_picture(self.path / name, self._size, kinds, MARK)

    @property
    def _size(self) -> tuple[int, int]:
        return self.intrinsics.width, self.intrinsics.height


def open_folder(path: Path) -> FrameSource:
    """Read and check frames.json and the trajectories.

    Raises:
        InputError: a file is missing, or lacks an entry; the message names it.
    """
    folder = _checked(path, path / MARK)
    stamps_ns = [entry.stamp_ns for entry in folder.entries]
    odometry = read_poses(path / "odometry.tum", stamps_ns, FIRST_STAMP_NS)
    truth = read_poses(path / "ground_truth.tum", stamps_ns, FIRST_STAMP_NS)
    label_hint = f"write what the labels are into {path / MARK}, such as {FRAME_EXAMPLE}"
    return FrameSource(
        n_frames=len(folder.entries),
        frames=folder.frames,
        trajectories=Trajectories(odometry, truth),
        unit_hint=partial(_unit_hint, path / MARK, folder.depth_scale_m),
        label_hint=label_hint,
        skipped=folder.skipped,
    )


def _unit_hint(file: Path, scale_m: float, factor: float) -> str:
    return f"write about {scale_m * factor:g} as depth_scale_m (now {scale_m:g}) in {file}"


def _checked(path: Path, file: Path) -> PictureFolder:
    content = read_json(file, "what --help says of it")
    if not isinstance(content.get("intrinsics"), dict):
        told = f"{file} lacks the camera; write {CAMERA_EXAMPLE}, in pixels"
        raise InputError("frames_json", told)
    rate_hz = _above_zero(content, "rate_hz", 10.0, file)
    return PictureFolder(
        path,
        intrinsics_from(content["intrinsics"], file),
        _entries(content.get("frames"), rate_hz, file),
        _above_zero(content, "depth_scale_m", 1e-3, file),
    )


def _above_zero(content: dict[str, Any], name: str, usual: float, file: Path) -> float:
    try:
        value = float(content.get(name, usual))
    except (TypeError, ValueError, OverflowError):
        value = np.nan
    if not 0 < value < np.inf:
        told = f"{file} has {name} {content[name]!r}; write a number above zero, usual is {usual:g}"
        raise InputError("frames_json", told)
    return value


def _entries(items: Any, rate_hz: float, file: Path) -> tuple[FrameEntry, ...]:
    """The frames in the order of their stamps, of which no two are alike."""
    if not isinstance(items, list) or not items:
        raise InputError("frames_json", f'{file} has no frames; write "frames": [{FRAME_EXAMPLE}, ...]')
    entries = sorted((_entry(item, rate_hz, file) for item in items), key=lambda entry: entry.stamp_ns)
    twice = [number for number, n in Counter(entry.number for entry in entries).items() if n > 1]
    if twice:
        raise InputError("frames_json", f"{file} has frame {twice[0]} more than once; write each frame once")
    for one, other in pairwise(entries):
        if one.stamp_ns == other.stamp_ns:
            told = f"{file} has frames {one.number} and {other.number} at one time"
            raise InputError("frames_json", f"{told}; write a stamp_s of its own for each, in seconds")
    return tuple(entries)


def _entry(item: Any, rate_hz: float, file: Path) -> FrameEntry:
    try:
        number = int(item["frame"])
        if number < 0 or number != float(item["frame"]):
            raise ValueError(f"frame {item['frame']!r} is no count")
        stamp_s = float(item.get("stamp_s", number / rate_hz))
        return FrameEntry(number, _stamp_ns(stamp_s, number, file), tuple(item["instances"]))
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        told = f"{file} {what_is_wrong(error)} in a frame; write {FRAME_EXAMPLE}, stamp_s in seconds"
        raise InputError("frames_json", told) from error


def _stamp_ns(stamp_s: float, number: int, file: Path) -> int:
    """Seconds of a folder as a stamp of its bag."""
    if not 0 <= stamp_s * 1e9 < LATEST_NS - FIRST_STAMP_NS:
        raise InputError("stamp", f"{file} has frame {number} at {stamp_s:g} s; write stamp_s in seconds")
    return FIRST_STAMP_NS + round(stamp_s * 1e9)


def _instance(item: Any, stem: str, file: Path) -> Instance:
    example = f'{{"id": 1, "category": "mug"}} for each instance of frame {stem}'
    try:
        label, category, score = item["id"], item["category"], item.get("score", 1.0)
    except (KeyError, TypeError, AttributeError) as error:
        told = f"{file} {what_is_wrong(error)} in an instance of frame {stem}; write {example}"
        raise InputError("frames_json", told) from error
    return make_instance(label, category, score, file, example)
