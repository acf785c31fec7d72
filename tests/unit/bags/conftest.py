"""Small bags and picture folders."""

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from neuse.embedding.embedding import weights_file
from neuse.embedding.network import load_network, save_network
from neuse.geometry import exp
from neuse.records import Instance, Intrinsics, RgbdFrame

SIZE = (24, 32)
CAMERA = Intrinsics(width=SIZE[1], height=SIZE[0], fx=30.0, fy=31.0, cx=15.5, cy=11.5)
STAMPS_NS = [1_000_000_001 + i * 100_000_000 for i in range(5)]


@pytest.fixture
def frames() -> list[RgbdFrame]:
    """Five small frames with colour, whose depths are whole millimetres."""
    rng = np.random.default_rng(2)
    return [_frame(stamp_ns, rng) for stamp_ns in STAMPS_NS]


def _frame(stamp_ns: int, rng: np.random.Generator) -> RgbdFrame:
    depth_mm = rng.integers(600, 640, SIZE)
    depth_mm[:2] = 0
    mask = np.zeros(SIZE, dtype=np.int32)
    mask[5:14, 3:10], mask[8:20, 15:28] = 7, 200
    instances = (Instance(7, "mug", 0.75), Instance(200, "bottle", 1.0))
    color = rng.integers(0, 255, (*SIZE, 3), dtype=np.uint8)
    return RgbdFrame(stamp_ns, depth_mm.astype(np.float32) * np.float32(1e-3), mask, instances, CAMERA, color)


@pytest.fixture
def frames_bag(frames: list[RgbdFrame], tmp_path: Path) -> Path:
    """A bag of the frames, with odometry."""
    from neuse_bags import topics
    from neuse_bags.conversions import odometry_to_msg
    from neuse_bags.frames import write_frame
    from neuse_bags.mcap_file import BagWriter

    path = tmp_path / "frames.mcap"
    with BagWriter(path) as writer:
        topics.declare(writer, (*topics.FRAME_TOPICS, *topics.COLOR_TOPICS, topics.ODOMETRY))
        for index, frame in enumerate(frames):
            write_frame(writer, frame)
            pose = odometry_to_msg(frame.stamp_ns, exp(np.full(6, 0.1 * index)), "odom")
            writer.write(topics.ODOMETRY.name, pose, frame.stamp_ns)
    return path


@pytest.fixture
def picture_folder(tmp_path: Path) -> Callable[..., Path]:
    """Factory of folders as `convert` takes them; keyword arguments replace entries of frames.json."""

    def make(**changes: object) -> Path:
        folder = tmp_path / "pictures"
        folder.mkdir(exist_ok=True)
        instances = [{"id": 7, "category": "mug"}, {"id": 9, "category": "bottle", "score": 0.5}]
        camera = {name: getattr(CAMERA, name) for name in Intrinsics.__annotations__}
        frames_json = {
            "intrinsics": camera,
            "frames": [{"frame": n, "instances": instances} for n in (0, 12)],
        }
        (folder / "frames.json").write_text(json.dumps(frames_json | changes))
        for name in ("00", "12"):
            _write_pictures(folder, name)
        return folder

    return make


@pytest.fixture
def kettle_weights(tmp_path: Path) -> Path:
    """Weights of a category of one's own."""
    network = load_network(weights_file("mug"))
    network.category = "kettle"
    save_network(network, tmp_path / "kettle.safetensors", {})
    return tmp_path / "kettle.safetensors"


def _write_pictures(folder: Path, name: str) -> None:
    rng = np.random.default_rng(int(name))
    mask = np.zeros(SIZE, dtype=np.uint8)
    mask[4:9, 4:9], mask[12:19, 20:29] = 7, 9
    cv2.imwrite(str(folder / f"{name}_depth.png"), rng.integers(500, 600, SIZE).astype(np.uint16))
    cv2.imwrite(str(folder / f"{name}_mask.png"), mask)
    cv2.imwrite(str(folder / f"{name}_color.png"), rng.integers(0, 255, (*SIZE, 3), dtype=np.uint8))
