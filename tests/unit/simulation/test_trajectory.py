import numpy as np
import pytest

from neuse.errors import ParamError
from neuse.simulation.trajectory import Waypoint, closed_trajectory


def waypoints(n=8, radius_m=2.0, phase=0.0):
    angles = np.arange(n) * 2 * np.pi / n + phase
    circle = np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
    return [Waypoint(radius_m * c + [0, 0, 1.2], 0.3 * np.roll(c, 1) + [0, 0, 0.7]) for c in circle]


def rotation_steps_rad(T):
    R = np.swapaxes(T[:-1, :3, :3], 1, 2) @ T[1:, :3, :3]
    return np.arccos(np.clip((np.trace(R, axis1=1, axis2=2) - 1) / 2, -1, 1))


def test_path_passes_every_waypoint_looking_where_it_should():
    asked = waypoints()
    T = closed_trajectory([asked], frames=4000).T_world_camera
    for waypoint in asked:
        nearest = np.argmin(np.linalg.norm(T[:, :3, 3] - waypoint.position, axis=1))
        assert T[nearest, :3, 3] == pytest.approx(waypoint.position, abs=5e-3)
        direction = (waypoint.target - waypoint.position) / np.linalg.norm(
            waypoint.target - waypoint.position
        )
        assert T[nearest, :3, 2] @ direction > np.cos(0.01)


def test_path_is_closed():
    T = closed_trajectory([waypoints()], frames=300).T_world_camera
    steps_m = np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1)
    assert np.linalg.norm(T[0, :3, 3] - T[-1, :3, 3]) == pytest.approx(steps_m.mean(), rel=0.5)


def test_steps_share_motion_and_turning_evenly():
    T = closed_trajectory([waypoints()], frames=500, turn_radius_m=1.5).T_world_camera
    moved_m = np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1)
    steps = np.hypot(moved_m, 1.5 * rotation_steps_rad(T))
    assert steps == pytest.approx(steps.mean(), rel=0.02)


def test_velocity_has_no_jumps():
    T = closed_trajectory([waypoints()], frames=2000).T_world_camera
    velocity = np.diff(T[:, :3, 3], axis=0)
    assert (
        np.linalg.norm(np.diff(velocity, axis=0), axis=1).max()
        < 0.02 * np.linalg.norm(velocity, axis=1).max()
    )


def test_traversals_begin_at_their_first_waypoint():
    first, second = waypoints(), waypoints(phase=0.2, radius_m=2.5)
    trajectory = closed_trajectory([first, second], frames=1000)
    assert trajectory.start_of(0) == 0
    start = trajectory.start_of(1)
    assert list(trajectory.traversal[[start - 1, start]]) == [0, 1]
    step_m = trajectory.length_m / 1000
    assert np.linalg.norm(trajectory.T_world_camera[start, :3, 3] - second[0].position) < 2 * step_m


def test_length_of_a_circle_is_its_circumference():
    assert closed_trajectory([waypoints(16)], 1000).length_m == pytest.approx(4 * np.pi, rel=2e-3)


@pytest.mark.parametrize(("count", "frames"), [(2, 10), (8, 1)])
def test_too_few_waypoints_or_frames_are_refused(count, frames):
    with pytest.raises(ParamError, match=f"got {count} and {frames}"):
        closed_trajectory([waypoints(count)], frames)
