"""BOP: a scene folder of one of the benchmark's data sets, such as .../test/000048.

scene_camera.json  for each picture cam_K and depth_scale (millimetres of one unit); cam_R_w2c and cam_t_w2c
                   (millimetres), where they are there, become the true poses of the camera
scene_gt.json      for each picture its objects with obj_id
depth/000001.png   16 bit;  rgb/000001.png or .jpg may be missing
mask_visib/000001_000000.png   visible part of the picture's first object, and so on
categories.json    which obj_id is what: {"13": "mug", "5": "bottle"}, here or in a folder above; others are
                   background. rate_hz (30) may stand beside: {"rate_hz": 10, "13": "mug"}
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from neuse.errors import InputError
from neuse.geometry import inverse, make_transform
from neuse.records import Instance, Intrinsics, RgbdFrame
from neuse.slam.checks import is_rigid
from neuse_bags.folder import FIRST_STAMP_NS
from neuse_bags.pictures import (
    DEPTH_KINDS,
    MASK_KINDS,
    FrameSource,
    Poses,
    Trajectories,
    read_color,
    read_json,
    read_picture,
    what_is_wrong,
)
from neuse_bags.trajectory_files import LATEST_NS
from neuse_slam_node.poses import FARTHEST_M

MARK = "scene_camera.json"
RATE_HZ = 30.0
CATEGORIES_EXAMPLE = '{"13": "mug", "5": "bottle"}, the category of each obj_id that is to be mapped'
CAMERA_EXAMPLE = '{"cam_K": [fx, 0, cx, 0, fy, cy, 0, 0, 1], "depth_scale": 1.0} for each picture'
OBJECTS_EXAMPLE = '[{"obj_id": 13}, ...] for each picture'


@dataclass(frozen=True)
class BopScene:
    """The JSON files of a scene, by the number of the picture as it stands there."""

    path: Path
    cameras: Mapping[str, Any]
    objects: Mapping[str, Any]
    categories: Mapping[str, str]
    rate_hz: float
    skipped: list[InputError] = field(default_factory=list)

    def frames(self) -> Iterator[RgbdFrame]:
        """The frames, one by one.

        Raises:
            InputError: a picture or an entry is missing, or does not fit.
        """
        for key in sorted(self.cameras, key=int):
            yield self._frame(key)

    def true_poses(self) -> Poses:
        """The poses of the camera, of the pictures that have one."""
        poses = [self._true_pose(key) for key in sorted(self.cameras, key=int)]
        return [pose for pose in poses if pose is not None]

    def _frame(self, key: str) -> RgbdFrame:
        stamp_ns, name = self._stamp_ns(key), f"{int(key):06d}"
        depth = read_picture(self.path / "depth" / f"{name}.png", None, DEPTH_KINDS, MARK)
        height, width = depth.shape
        intrinsics, scale_m = _camera(self.cameras[key], key, (width, height), self.path / MARK)
        mask, instances = self._segmentation(key, name, (width, height))
        color = next((self.path / "rgb").glob(f"{name}.*"), None)
        return RgbdFrame(
            stamp_ns=stamp_ns,
            depth_m=(depth * scale_m).astype(np.float32),
            mask=mask,
            instances=instances,
            intrinsics=intrinsics,
            color=None if color is None else read_color(color, (width, height), MARK, self.skipped),
        )

    def _segmentation(
        self, key: str, name: str, size: tuple[int, int]
    ) -> tuple[np.ndarray, tuple[Instance, ...]]:
        """Labels, one more than the object's place in scene_gt.json, and what they are."""
        labels, instances = np.zeros(size[::-1], dtype=np.uint16), []
        for index, obj_id in enumerate(self._object_ids(key)):
            category = self.categories.get(obj_id)
            if category is not None:
                path = self.path / "mask_visib" / f"{name}_{index:06d}.png"
                labels[read_picture(path, size, MASK_KINDS, "scene_gt.json") > 0] = index + 1
                instances.append(Instance(index + 1, str(category)))
        return labels, tuple(instances)

    def _object_ids(self, key: str) -> list[str]:
        try:
            return [str(item["obj_id"]) for item in self.objects[key]]
        except (KeyError, TypeError) as error:
            told = f"{self.path / 'scene_gt.json'} {what_is_wrong(error)} of picture {key}"
            raise InputError("scene_gt", f"{told}; write {OBJECTS_EXAMPLE}") from error

    def _true_pose(self, key: str) -> tuple[int, np.ndarray] | None:
        camera = self.cameras[key]
        if not camera.keys() >= {"cam_R_w2c", "cam_t_w2c"}:
            return None
        try:
            R = np.array(camera["cam_R_w2c"], dtype=np.float64).reshape(3, 3)
            T_camera_world = make_transform(R, np.array(camera["cam_t_w2c"], dtype=np.float64) * 1e-3)
            if not is_rigid(T_camera_world) or np.abs(T_camera_world).max() >= FARTHEST_M:
                raise ValueError("not rigid")
        except (ValueError, TypeError) as error:
            told = f"{self.path / MARK}: cam_R_w2c or cam_t_w2c of picture {key} is no pose ({error})"
            raise InputError("scene_camera", f"{told}; write 9 and 3 numbers") from error
        return self._stamp_ns(key), inverse(T_camera_world)

    def _stamp_ns(self, key: str) -> int:
        stamp_s = int(key) / self.rate_hz if len(key) < 20 else np.inf
        if stamp_s * 1e9 >= LATEST_NS - FIRST_STAMP_NS:
            told = f"{self.path / MARK} has picture {key[:20]}; number them from 0, in order of time"
            raise InputError("scene_camera", told)
        return FIRST_STAMP_NS + round(stamp_s * 1e9)


def open_bop(path: Path) -> FrameSource:
    """Read the JSON files of a scene.

    Raises:
        InputError: one is missing or wrong.
    """
    cameras = _by_number(path / MARK, CAMERA_EXAMPLE)
    objects = read_json(path / "scene_gt.json", OBJECTS_EXAMPLE)
    places = [folder / "categories.json" for folder in (path, *path.resolve().parents[:2])]
    file = next((place for place in places if place.exists()), places[0])
    categories = read_json(file, CATEGORIES_EXAMPLE)
    rate_hz = categories.pop("rate_hz", RATE_HZ)
    if not categories or not isinstance(rate_hz, float | int) or not 0 < rate_hz < np.inf:
        raise InputError("categories", f"{file} has no category or no rate_hz; write {CATEGORIES_EXAMPLE}")
    scene = BopScene(path, cameras, objects, categories, rate_hz)
    hint = f"as depth_scale in {path / MARK}"
    return FrameSource(
        n_frames=len(cameras),
        frames=scene.frames,
        trajectories=Trajectories(ground_truth=scene.true_poses()),
        unit_hint=lambda factor: (
            f"write the millimetres of one unit, about {factor:g} times those now, {hint}"
        ),
        label_hint=f"write into {file} {_categories_example(objects)}",
        skipped=scene.skipped,
    )


def _categories_example(objects: Mapping[str, Any]) -> str:
    """An entry for an object that the scene has."""
    entries = (item for items in objects.values() if isinstance(items, list) for item in items)
    found = {str(item["obj_id"]) for item in entries if isinstance(item, dict) and "obj_id" in item}
    known = ", ".join(sorted(found, key=lambda name: (len(name), name))[:10])
    return (
        f'what its objects are, such as {{"{min(found)}": "mug"}}; it has {known}'
        if found
        else CATEGORIES_EXAMPLE
    )


def _by_number(path: Path, example: str) -> dict[str, Any]:
    """Entries of the pictures by their number."""
    content = read_json(path, example)
    if not content or not all(key.isdecimal() and isinstance(entry, dict) for key, entry in content.items()):
        raise InputError(path.stem, f"{path} has no pictures by number; write {example}")
    return content


def _camera(entry: Any, key: str, size: tuple[int, int], path: Path) -> tuple[Intrinsics, float]:
    """Pinhole camera of one picture, and the metres of one unit of its depth."""
    try:
        fx, _, cx, _, fy, cy = map(float, entry["cam_K"][:6])
        scale_mm = float(entry["depth_scale"])
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        told = f"{path} {what_is_wrong(error)} of picture {key}; write {CAMERA_EXAMPLE}"
        raise InputError("scene_camera", told) from error
    intrinsics = Intrinsics(*size, fx, fy, cx, cy)
    if not (intrinsics.is_sound and 0 < scale_mm < np.inf):
        told = f"{path} has focal length {fx:g}, {fy:g} and depth_scale {scale_mm:g} in picture {key}"
        raise InputError("scene_camera", f"{told}; all must be above zero")
    return intrinsics, scale_mm * 1e-3
