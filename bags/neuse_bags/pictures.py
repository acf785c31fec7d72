"""Pictures and JSON files of people's own folders, checked; every fault names the file and what to write."""

import json
import os
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from neuse.errors import InputError
from neuse.geometry import Array
from neuse.records import Instance, Intrinsics, RgbdFrame

DEPTH_KINDS = (np.uint16,)
MASK_KINDS = (np.uint8, np.uint16)
COLOR_KINDS = (np.uint8,)
MOST_PIXELS = 2**26
Poses = list[tuple[int, Array]]


@dataclass(frozen=True)
class Trajectories:
    """Poses of the camera by stamp_ns, T_frame_camera, each in a frame of its own; empty where unknown."""

    odometry: Poses = field(default_factory=list)
    ground_truth: Poses = field(default_factory=list)


@dataclass(frozen=True)
class FrameSource:
    """Somebody's recording, whatever its layout.

    frames: makes the frames one by one; raises InputError where one cannot be made.
    unit_hint: says where to write the unit of depth, given the factor that it is to be multiplied by.
    label_hint: where the labels of the masks are written, and how.    notes: what was left out, for people.
    skipped: grows while the frames are made: the colour pictures that could not be used.
    """

    n_frames: int
    frames: Callable[[], Iterator[RgbdFrame]]
    trajectories: Trajectories
    unit_hint: Callable[[float], str]
    label_hint: str
    notes: tuple[str, ...] = ()
    skipped: Sequence[InputError] = ()


def read_picture(
    path: Path, size: tuple[int, int] | None, kinds: tuple[type, ...], asked_by: str
) -> np.ndarray:
    """(h, w) pixels of one channel, or (h, w, 3) uint8 RGB for COLOR_KINDS.

    size: (width, height) that is expected, None for any.    asked_by: the file that names the picture.
    Raises:
        InputError: missing, unreadable, or of another size or kind.
    """
    if not os.path.isfile(path):  # which takes names that no file can have
        raise InputError("missing_picture", f"{path} does not exist; {asked_by} asks for it")
    check_png(path.read_bytes(), 4 * size[0] * size[1] if size else MOST_PIXELS, str(path))
    colored = kinds is COLOR_KINDS
    pixels = cv2.imread(str(path), cv2.IMREAD_COLOR if colored else cv2.IMREAD_UNCHANGED)
    if pixels is None:
        raise InputError("unreadable_picture", f"{path} is not a readable picture")
    height, width = pixels.shape[:2] if size is None else size[::-1]
    if pixels.shape != (height, width) + ((3,) if colored else ()) or pixels.dtype not in kinds:
        wanted = " or ".join(str(np.dtype(kind).itemsize * 8) for kind in kinds)
        raise InputError(
            "unequal_size",
            f"{path} is {_description(pixels)}; {asked_by} wants {width} x {height} pixels, "
            f"{3 if colored else 1} channel(s) of {wanted} bit",
        )
    return cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB) if colored else pixels


def read_color(
    path: Path, size: tuple[int, int], asked_by: str, skipped: list[InputError]
) -> np.ndarray | None:
    """(h, w, 3) uint8 RGB; None where it cannot be used, as it is for people; its fault joins `skipped`."""
    try:
        return read_picture(path, size, COLOR_KINDS, asked_by)
    except InputError as error:
        skipped.append(error)
        return None


def check_png(data: bytes, most_pixels: int, name: str) -> None:
    """Look at a PNG before it is decoded; other formats pass.

    Raises:
        InputError: it claims a size, or a part of a size, that would only take memory.
    """
    if not data.startswith(b"\x89PNG") or len(data) < 24:
        return  # the decoder has more to say
    width, height = struct.unpack_from(">II", data, 16)
    if width * height > most_pixels:
        told = f"{name} claims to be {width} x {height} pixels"
        raise InputError("unequal_size", f"{told}, which is far too large; export it again")
    place = 8
    while place + 12 <= len(data):
        place += 12 + struct.unpack_from(">I", data, place)[0]
    if place > len(data):
        raise InputError("unreadable_picture", f"{name} is not a readable picture: a part of it is missing")


def read_json(path: Path, example: str) -> dict[str, Any]:
    """The object in a JSON file.

    Raises:
        InputError: missing, no JSON, or no object; the message shows the example.
    """
    try:
        content = json.loads(path.read_text())
    except OSError as error:
        told = f"{path} cannot be read ({error.strerror}); write {example}"
        raise InputError(path.stem, told) from error
    except (ValueError, RecursionError) as error:  # of JSON, or of its encoding
        raise InputError(path.stem, f"{path} is no JSON: {error}") from error
    if not isinstance(content, dict):
        raise InputError(path.stem, f"{path} holds a {type(content).__name__}; write {example}")
    return content


def what_is_wrong(error: Exception) -> str:
    """A failed look-up or conversion, in words that go on behind the name of a file."""
    return f"lacks {error}" if isinstance(error, KeyError) else f"has a wrong entry ({error})"


def intrinsics_from(values: Any, path: Path) -> Intrinsics:
    """Pinhole camera from an object with width, height, fx, fy, cx, cy.

    Raises:
        InputError: an entry is missing or not positive.
    """
    try:
        width, height = int(values["width"]), int(values["height"])
        fx, fy, cx, cy = (float(values[name]) for name in ("fx", "fy", "cx", "cy"))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        told = f"{path} {what_is_wrong(error)}; write width, height, fx, fy, cx, cy in pixels"
        raise InputError(path.stem, told) from error
    made = Intrinsics(width, height, fx, fy, cx, cy)
    if not made.is_sound:
        told = f"{path} has focal length {fx:g}, {fy:g} and size {width} x {height}"
        raise InputError(path.stem, f"{told}; write those of the calibrated camera in pixels")
    return made


def make_instance(label: Any, category: Any, score: Any, path: Path, example: str) -> Instance:
    """An entry of a segmentation.

    Raises:
        InputError: the label is none that a mask can have, or the score is no number.
    """
    try:
        made = Instance(int(label), str(category), float(score))
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError("instances", f"{path}: {error}; write {example}") from error
    if not 0 < made.label <= np.iinfo(np.uint16).max:
        raise InputError("instances", f"{path} has label {label}, which no mask can have; write {example}")
    if not isinstance(category, str) or not category or not 0.0 <= made.score <= 1.0:
        raise InputError("instances", f"{path} has {made}; write {example}, and scores as shares of one")
    return made


def _description(pixels: np.ndarray) -> str:
    channels = pixels.shape[2] if pixels.ndim == 3 else 1
    bits = pixels.dtype.itemsize * 8
    return f"{pixels.shape[1]} x {pixels.shape[0]} pixels, {channels} channel(s) of {bits} bit"
