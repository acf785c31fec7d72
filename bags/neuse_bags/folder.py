"""People's own pictures: a folder of colour, depth and mask PNGs with frames.json.

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

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from neuse.errors import InputError
from neuse.geometry import Array, transform_from_quaternion
from neuse.records import Instance, Intrinsics, RgbdFrame

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
        stem = f"{entry['frame']:02d}"
        depth = self._picture(f"{stem}_depth.png", (np.uint16,))
        color_path = self.path / f"{stem}_color.png"
        color = self._picture(color_path.name, (np.uint8,), channels=3) if color_path.exists() else None
        return RgbdFrame(
            stamp_ns=stamp_ns(entry.get("stamp_s", entry["frame"] / self.rate_hz)),
            depth_m=(depth * self.depth_scale_m).astype(np.float32),
            mask=self._picture(f"{stem}_mask.png", (np.uint8, np.uint16)),
            instances=tuple(_instance(item, stem) for item in entry["instances"]),
            intrinsics=self.intrinsics,
            color=None if color is None else cv2.cvtColor(color, cv2.COLOR_BGR2RGB),
        )

    def _picture(self, name: str, kinds: tuple[type, ...], channels: int = 1) -> np.ndarray:
        path = self.path / name
        if not path.exists():
            raise InputError("missing_picture", f"{path} does not exist; frames.json asks for it")
        pixels = cv2.imread(str(path), cv2.IMREAD_COLOR if channels == 3 else cv2.IMREAD_UNCHANGED)
        if pixels is None:
            raise InputError("unreadable_picture", f"{path} is not a readable picture")
        expected = (self.intrinsics.height, self.intrinsics.width) + ((3,) if channels == 3 else ())
        if pixels.shape != expected or pixels.dtype not in kinds:
            bits = " or ".join(str(np.dtype(kind).itemsize * 8) for kind in kinds)
            raise InputError(
                "unequal_size",
                f"{path} is {_size(pixels)}; frames.json wants {expected[1]} x {expected[0]} pixels, "
                f"{channels} channel(s) of {bits} bit",
            )
        return pixels


def open_folder(path: Path) -> PictureFolder:
    """Read and check frames.json.

    Raises:
        InputError: frames.json is missing, is no JSON, or lacks an entry; the message names it.
    """
    file = path / "frames.json"
    try:
        content = json.loads(file.read_text())
        intrinsics = Intrinsics(**{name: content["intrinsics"][name] for name in Intrinsics.__annotations__})
        entries = tuple(sorted(content["frames"], key=lambda entry: entry["frame"]))
        [entry["instances"] for entry in entries]
    except OSError as error:
        raise InputError("frames_json", f"{file} cannot be read ({error.strerror}); see --help") from error
    except json.JSONDecodeError as error:
        raise InputError("frames_json", f"{file} is no JSON: {error}") from error
    except (KeyError, TypeError) as error:
        raise InputError("frames_json", f"{file} lacks {error}; see --help for its entries") from error
    if not entries or intrinsics.fx <= 0 or intrinsics.fy <= 0:
        raise InputError("frames_json", f"{file} has {len(entries)} frames and focal length {intrinsics.fx}")
    return PictureFolder(
        path, intrinsics, entries, content.get("rate_hz", 10.0), content.get("depth_scale_m", 1e-3)
    )


def read_tum(path: Path) -> list[tuple[int, Array]]:
    """(stamp_ns, T_frame_camera) of a TUM trajectory file; empty when there is none.

    Raises:
        InputError: a line does not have eight numbers.
    """
    if not path.exists():
        return []
    try:
        rows = np.atleast_2d(np.loadtxt(path))
        return [(stamp_ns(row[0]), transform_from_quaternion(row[4:8], row[1:4])) for row in rows]
    except (ValueError, IndexError) as error:
        raise InputError("tum", f"{path} is not `stamp_s x y z qx qy qz qw` a line: {error}") from error


def stamp_ns(stamp_s: float) -> int:
    """Seconds of a folder as a stamp of its bag."""
    return FIRST_STAMP_NS + round(stamp_s * 1e9)


def _instance(item: dict[str, Any], stem: str) -> Instance:
    try:
        return Instance(int(item["id"]), str(item["category"]), float(item.get("score", 1.0)))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            "frames_json", f"an instance of frame {stem} lacks {error} (id, category)"
        ) from error


def _size(pixels: np.ndarray) -> str:
    channels = pixels.shape[2] if pixels.ndim == 3 else 1
    bits = pixels.dtype.itemsize * 8
    return f"{pixels.shape[1]} x {pixels.shape[0]} pixels, {channels} channel(s) of {bits} bit"
