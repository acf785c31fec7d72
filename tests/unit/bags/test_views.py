"""Views for the report, from what a made-up run recorded of a bag of small frames."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from neuse.embedding.code import Code
from neuse.geometry import make_transform
from neuse.records import Observation, ObservedFrame, RgbdFrame
from neuse_bags import topics
from neuse_bags.mcap_file import BagWriter
from neuse_bags.views import N_VIEWS, read_observed, read_views
from neuse_encoder_node.conversions import observed_frame_to_msg

CODE = Code("mug", False, np.arange(24.0).reshape(8, 3), np.full(8, 8**-0.5), np.full(6, 0.1))


@pytest.fixture
def recording(frames: list[RgbdFrame], tmp_path: Path) -> Path:
    """The mug of every frame, seen the larger the later."""
    path = tmp_path / "recording.mcap"
    with BagWriter(path) as writer:
        topics.declare(writer, (topics.OBSERVATIONS,))
        for size, frame in enumerate(frames, start=1):
            seen = Observation(7, 0.9, CODE, np.zeros((4, 3), np.float32), np.zeros(3), size)
            observed = ObservedFrame(frame.stamp_ns, (seen,), frame.intrinsics, frame.depth_m[::4, ::4])
            writer.write(topics.OBSERVATIONS.name, observed_frame_to_msg(observed, "camera"), frame.stamp_ns)
    return path


def _ball(code: Code) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(2, 0.1).apply_transform(make_transform(np.eye(3), [0, 0, 1]))


def test_views_have_picture_and_shape_of_frames_from_all_parts_of_the_run(
    recording: Path, frames_bag: Path, frames: list[RgbdFrame]
) -> None:
    views = read_views(frames_bag, read_observed(recording), {"mug": _ball})
    assert [view.frame.stamp_ns for view in views] == [frames[i].stamp_ns for i in (1, 3, 4)]
    assert len(views) == N_VIEWS
    for view, frame in zip(views, (frames[1], frames[3], frames[4]), strict=True):
        np.testing.assert_array_equal(view.frame.color, frame.color)
        (item,) = view.objects
        assert len(item.points) == np.sum((frame.mask == 7) & (frame.depth_m > 0))


def _bag_without_images(path: Path) -> Path:
    with BagWriter(path) as writer:
        topics.declare(writer, (topics.ODOMETRY,))
    return path


def test_bag_without_images_gives_no_views(recording: Path, tmp_path: Path) -> None:
    bare = _bag_without_images(tmp_path / "bare.mcap")
    assert read_views(bare, read_observed(recording), {"mug": _ball}) == []


def test_recording_without_observations_gives_no_views(frames_bag: Path) -> None:
    observed = read_observed(frames_bag)
    assert observed == []
    assert read_views(frames_bag, observed, {"mug": _ball}) == []
