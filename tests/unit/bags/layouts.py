"""Small recordings in the layouts of others: two frames of a mug and a bottle before a wall."""

import json
from pathlib import Path

import cv2
import numpy as np

SIZE = (24, 32)
STAMPS_S = ("1305031102.175304", "1305031102.275326")
CAMERA = {"width": 32, "height": 24, "fx": 30.0, "fy": 31.0, "cx": 15.5, "cy": 11.5}
DEPTH_M = 0.8


def labels() -> np.ndarray:
    """(24, 32) uint8: 1 is a mug, 2 a bottle."""
    mask = np.zeros(SIZE, dtype=np.uint8)
    mask[4:9, 4:9], mask[12:19, 20:25] = 1, 2
    return mask


def depth(units_per_m: float) -> np.ndarray:
    """(24, 32) uint16: objects at 0.8 m before a wall at 1.6 m, without readings in the first row."""
    depth_m = np.where(labels() > 0, DEPTH_M, 2 * DEPTH_M)
    depth_m[0] = 0
    return np.rint(depth_m * units_per_m).astype(np.uint16)


def color() -> np.ndarray:
    """(24, 32, 3) uint8."""
    return np.random.default_rng(0).integers(0, 255, (*SIZE, 3), dtype=np.uint8)


def write_json(path: Path, content: object) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))


def write_picture(path: Path, pixels: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), pixels)


def make_tum(path: Path) -> Path:
    """A TUM RGB-D folder; the colour stamps are 5 ms late."""
    write_json(path / "camera.json", CAMERA)
    write_json(path / "masks" / "instances.json", {"1": "mug", "2": "bottle"})
    colors = [f"{float(stamp) + 0.005:.6f}" for stamp in STAMPS_S]
    for stamp, later in zip(STAMPS_S, colors, strict=True):
        write_picture(path / "depth" / f"{stamp}.png", depth(5000))
        write_picture(path / "rgb" / f"{later}.png", color())
        write_picture(path / "masks" / f"{later}.png", labels())
    for name, stamps, folder in (("depth.txt", STAMPS_S, "depth"), ("rgb.txt", colors, "rgb")):
        lines = [f"{stamp} {folder}/{stamp}.png" for stamp in stamps]
        (path / name).write_text("\n".join(["# stamp filename", *lines, ""]))
    (path / "groundtruth.txt").write_text(f"# truth\n{STAMPS_S[0]} 1 2 3 0 0 0.6 0.8\n")
    return path


def make_bop(path: Path) -> Path:
    """A BOP scene of a mug (13), a bottle (5), and a toy (7) that no category is given for."""
    K = [30.0, 0, 15.5, 0, 31.0, 11.5, 0, 0, 1]
    camera = {"cam_K": K, "depth_scale": 0.1}
    turned = {"cam_R_w2c": [0, -1, 0, 1, 0, 0, 0, 0, 1], "cam_t_w2c": [1000.0, 0.0, 500.0]}
    objects = [{"obj_id": obj_id} for obj_id in (13, 7, 5)]
    write_json(path / "scene_camera.json", {"1": camera | turned, "10": camera | turned})
    write_json(path / "scene_gt.json", {"1": objects, "10": objects})
    write_json(path / "categories.json", {"13": "mug", "5": "bottle"})
    for name in ("000001", "000010"):
        write_picture(path / "depth" / f"{name}.png", depth(10000))
        write_picture(path / "rgb" / f"{name}.jpg", color())
        for index, label in ((0, 1), (2, 2)):
            visible = (labels() == label).astype(np.uint8) * 255
            write_picture(path / "mask_visib" / f"{name}_{index:06d}.png", visible)
    return path
