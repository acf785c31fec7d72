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

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from neuse.errors import InputError
from neuse.records import Instance, Intrinsics, RgbdFrame
from neuse_bags.pictures import (
    COLOR_KINDS,
    DEPTH_KINDS,
    MASK_KINDS,
    FrameSource,
    Trajectories,
    intrinsics_from,
    make_instance,
    read_json,
    read_picture,
)
from neuse_bags.trajectory_files import LATEST_NS, read_tum

MARK = "frames.json"
FIRST_STAMP_NS = 10**9  # a stamp of zero means "no time" to ROS


@dataclass(frozen=True)
class PictureFolder:
    """A checked frames.json and where its pictures lie."""

    path: Path
    intrinsics: Intrinsics
    entries: tuple[dict[str, Any], ...]
    rate_hz: float
    depth_scale_m: float

    def frames(self) -> Iterator[RgbdFrame]:
        """The frames, one by one.

        Raises:
            InputError: a picture is missing, unreadable, or of another size than the camera's.
        """
        for entry in self.entries:
            yield self._frame(entry)

    def _frame(self, entry: dict[str, Any]) -> RgbdFrame:
        stem = f"{int(entry['frame']):02d}"
        depth = self._picture(f"{stem}_depth.png", DEPTH_KINDS)
        color = f"{stem}_color.png"
        return RgbdFrame(
            stamp_ns=stamp_ns(entry.get("stamp_s", entry["frame"] / self.rate_hz)),
            depth_m=(depth * self.depth_scale_m).astype(np.float32),
            mask=self._picture(f"{stem}_mask.png", MASK_KINDS),
            instances=tuple(_instance(item, stem, self.path / MARK) for item in entry["instances"]),
            intrinsics=self.intrinsics,
            color=self._picture(color, COLOR_KINDS) if (self.path / color).exists() else None,
        )

    def _picture(self, name: str, kinds: tuple[type, ...]) -> np.ndarray:
        return read_picture(self.path / name, (self.intrinsics.width, self.intrinsics.height), kinds, MARK)


def open_folder(path: Path) -> FrameSource:
    """Read and check frames.json and the trajectories.

    Raises:
        InputError: a file is missing, or lacks an entry; the message names it.
    """
    folder = _checked(path, path / MARK)
    odometry = read_tum(path / "odometry.tum", FIRST_STAMP_NS)
    truth = read_tum(path / "ground_truth.tum", FIRST_STAMP_NS)
    hint = f"write the metres of one unit as depth_scale_m (now {folder.depth_scale_m:g}) in {path / MARK}"
    return FrameSource(len(folder.entries), folder.frames, Trajectories(odometry, truth), hint)


def _checked(path: Path, file: Path) -> PictureFolder:
    content = read_json(file, "what --help says of it")
    try:
        intrinsics = intrinsics_from(content["intrinsics"], file)
        entries = tuple(sorted(content["frames"], key=lambda entry: entry["frame"]))
        [(int(e["frame"]), float(e.get("stamp_s", 0)), list(e["instances"])) for e in entries]
        rate_hz = float(content.get("rate_hz", 10.0))
        depth_scale_m = float(content.get("depth_scale_m", 1e-3))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError("frames_json", f"{file} lacks {error}; see --help for its entries") from error
    if not entries or not 0 < rate_hz < np.inf or not 0 < depth_scale_m < np.inf:
        found = f"{len(entries)} frames, rate_hz {rate_hz:g} and depth_scale_m {depth_scale_m:g}"
        raise InputError("frames_json", f"{file} has {found}; all must be above zero and finite")
    return PictureFolder(path, intrinsics, entries, rate_hz, depth_scale_m)


def stamp_ns(stamp_s: float) -> int:
    """Seconds of a folder as a stamp of its bag.

    Raises:
        InputError: it is none that a message can hold.
    """
    if not 0 <= stamp_s * 1e9 < LATEST_NS - FIRST_STAMP_NS:
        raise InputError("stamp", f"{MARK} has a frame at {stamp_s:g} s; write stamp_s in seconds")
    return FIRST_STAMP_NS + round(stamp_s * 1e9)


def _instance(item: Any, stem: str, file: Path) -> Instance:
    example = f'{{"id": 1, "category": "mug"}} for each instance of frame {stem}'
    try:
        label, category, score = item["id"], item["category"], item.get("score", 1.0)
    except (KeyError, TypeError, AttributeError) as error:
        told = f"an instance of frame {stem} lacks {error}; write {example}"
        raise InputError("frames_json", f"{file}: {told}") from error
    return make_instance(label, category, score, file, example)
