import numpy as np
import pytest

from neuse.errors import MeshError
from neuse.evaluation.map_scene import STATUS_COLORS, SceneBuilder, level_frame, upward
from neuse.evaluation.trajectory import Trajectory
from neuse.geometry import Array, exp, inverse, make_transform, transform_points
from neuse.records import ObjectStatus

LYING = exp([np.pi / 2, 0, 0, 0, 0, 0])


def test_meshes_lie_where_the_codes_say_in_the_frame_of_the_picture(map_object, decode, T_any: Array) -> None:
    T_map_object = exp([0.2, 0.5, -0.3, 1.0, 2.0, 3.0])
    scene = SceneBuilder({"mug": decode}, T_any).scene([map_object(1, T_map_object)])
    expected = transform_points(T_any, T_map_object[:3, 3])
    np.testing.assert_allclose(scene.meshes[0].center_mass, expected, atol=1e-9)


def test_object_without_a_decoder_is_drawn_as_its_box(map_object) -> None:
    T_map_object = exp([0.2, 0.5, -0.3, 1.0, 2.0, 3.0])
    item = map_object(1, T_map_object, "teapot")
    (mesh,) = SceneBuilder({}, np.eye(4)).scene([item]).meshes
    in_object = transform_points(inverse(T_map_object), mesh.vertices)
    np.testing.assert_allclose(np.ptp(in_object, axis=0), item.box_size, atol=1e-9)


def test_code_without_a_surface_is_drawn_as_a_box(map_object) -> None:
    def fail(code: object) -> None:
        raise MeshError("no surface")

    (mesh,) = SceneBuilder({"mug": fail}, np.eye(4)).scene([map_object(1, np.eye(4))]).meshes
    assert len(mesh.faces) == 12


def test_what_was_decoded_once_is_not_decoded_again(map_object, decode) -> None:
    calls: list[object] = []
    builder = SceneBuilder({"mug": lambda code: calls.append(code) or decode(code)}, np.eye(4))
    for _ in range(3):
        builder.scene([map_object(1, np.eye(4))])
    assert len(calls) == 1


def test_colors_tell_the_status(map_object, decode) -> None:
    items = [
        map_object(i, make_transform(np.eye(3), [i, 0, 0]), status=s) for i, s in enumerate(ObjectStatus)
    ]
    scene = SceneBuilder({"mug": decode}, np.eye(4)).scene(items)
    assert [mesh.color for mesh in scene.colored()] == [STATUS_COLORS[status] for status in ObjectStatus]


def test_up_is_the_axis_of_the_objects_that_stand(map_object, helix: Trajectory, T_any: Array) -> None:
    T_map_world = inverse(T_any)
    poses = [exp([0, 0, 1.0, 1, 0, 0]), exp([0, 0, 2.0, 0, 1, 0]), LYING]
    items = [map_object(i, T_map_world @ T) for i, T in enumerate(poses)]
    up = upward(items, helix.transformed(T_map_world).T_frame_camera)
    np.testing.assert_allclose(T_any[:3, :3] @ up, [0, 0, 1], atol=1e-9)


def test_up_is_about_where_the_cameras_think_if_nothing_stands(map_object, helix: Trajectory) -> None:
    up = upward([map_object(1, LYING)], helix.T_frame_camera)
    assert up[2] > np.cos(np.deg2rad(5))


@pytest.mark.parametrize("up", [[0, 0, 1.0], [0, -1.0, 0], [0.6, 0, -0.8]])
def test_level_frame_is_a_rotation_that_puts_up_on_z(up: list[float]) -> None:
    T = level_frame(np.array(up))
    np.testing.assert_allclose(T[:3, :3] @ up, [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
