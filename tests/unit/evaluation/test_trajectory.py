import numpy as np
import pytest

from neuse.errors import InputError
from neuse.evaluation.trajectory import FramePose, Trajectory, smoothed_trajectory, trajectory_of, tum_lines
from neuse.geometry import exp, inverse
from neuse.records import Keyframe


def test_stamps_that_do_not_increase_are_refused() -> None:
    with pytest.raises(InputError, match="stamps must increase"):
        Trajectory(np.array([1, 1]), np.tile(np.eye(4), (2, 1, 1)))


def test_stamps_and_poses_of_unequal_number_are_refused() -> None:
    with pytest.raises(InputError, match="2 stamps"):
        Trajectory(np.array([1, 2]), np.eye(4)[None])


def test_pose_is_found_by_a_stamp_that_is_nearly_right(helix: Trajectory) -> None:
    found = helix.at(int(helix.stamps_ns[5]) + 9_000_000)
    assert found is not None
    np.testing.assert_array_equal(found, helix.T_frame_camera[5])


def test_pose_is_unknown_far_from_any_stamp(helix: Trajectory) -> None:
    assert helix.at(int(helix.stamps_ns[5]) + 40_000_000) is None
    assert trajectory_of([], []).at(0) is None


def test_part_of_a_trajectory_excludes_its_end(helix: Trajectory) -> None:
    part = helix.between(int(helix.stamps_ns[3]), int(helix.stamps_ns[7]))
    np.testing.assert_array_equal(part.stamps_ns, helix.stamps_ns[3:7])


def test_length_is_the_sum_of_the_steps() -> None:
    corners = [[0, 0, 0], [3, 0, 0], [3, 4, 0]]
    poses = [
        np.block([[np.eye(3), np.array(p)[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]]) for p in corners
    ]
    assert trajectory_of([1, 2, 3], poses).length_m == pytest.approx(7.0)


def test_smoothing_puts_keyframes_where_the_last_optimisation_did(helix: Trajectory) -> None:
    frames = [
        FramePose(int(s), T, i)
        for i, (s, T) in enumerate(zip(helix.stamps_ns, helix.T_frame_camera, strict=True))
    ]
    final = [Keyframe(f.keyframe_id, f.stamp_ns, f.T_map_camera @ exp(np.full(6, 0.01))) for f in frames]
    smoothed = smoothed_trajectory(frames, final)
    np.testing.assert_allclose(smoothed.T_frame_camera, [k.T_map_camera for k in final], atol=1e-12)


def test_smoothing_carries_frames_rigidly_with_the_keyframe_before_them(helix: Trajectory) -> None:
    frames = [
        FramePose(int(s), T, i if i % 10 == 0 else -1)
        for i, (s, T) in enumerate(zip(helix.stamps_ns, helix.T_frame_camera, strict=True))
    ]
    keyframes = [
        Keyframe(i, frames[i].stamp_ns, exp([0.1, 0, 0.2, 0, 1, 0]) @ frames[i].T_map_camera)
        for i in (10, 20)
    ]
    smoothed = smoothed_trajectory(frames, keyframes).T_frame_camera
    np.testing.assert_array_equal(smoothed[:10], helix.T_frame_camera[:10])
    expected = inverse(helix.T_frame_camera[10]) @ helix.T_frame_camera[15]
    np.testing.assert_allclose(inverse(smoothed[10]) @ smoothed[15], expected, atol=1e-12)


def test_tum_lines_are_read_back_by_evo(helix: Trajectory, tmp_path) -> None:
    from evo.tools.file_interface import read_tum_trajectory_file

    path = tmp_path / "trajectory.tum"
    path.write_text("\n".join(tum_lines(helix)))
    read = read_tum_trajectory_file(str(path))
    np.testing.assert_allclose(np.array(read.poses_se3), helix.T_frame_camera, atol=1e-8)
    assert path.read_text().startswith("1000000000.000000007 ")
