import numpy as np
import pytest
import trimesh

from neuse.errors import MeshError, ParamError
from neuse.geometry import inverse, make_transform, transform_points
from neuse.records import Intrinsics
from neuse.simulation.camera import NOTHING, DepthCamera, RayScene, Solid, look_at

INTRINSICS = Intrinsics(width=160, height=120, fx=150.0, fy=140.0, cx=79.0, cy=60.5)
EYE, TARGET = np.array([0.6, -0.9, 1.1]), np.array([0.05, 0.1, 0.4])


@pytest.fixture
def camera():
    return DepthCamera(INTRINSICS)


@pytest.fixture
def scene():
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
    box = trimesh.creation.box((0.2, 0.3, 0.1))
    floor = trimesh.creation.box((6.0, 6.0, 0.1))
    return RayScene(
        [
            Solid(floor, make_transform(np.eye(3), [0.0, 0.0, -0.05])),
            Solid(ball, make_transform(np.eye(3), [0.1, 0.0, 0.5]), label=7),
            Solid(box, make_transform(np.eye(3), [-0.2, 0.2, 0.05]), label=3),
        ]
    )


def test_depth_is_along_z_and_back_projects_onto_the_surface(camera, scene):
    T_world_camera = look_at(EYE, TARGET)
    rendering = camera.render(scene, T_world_camera)
    pixels = np.flatnonzero(rendering.label == 7)
    points = camera.back_project(pixels, rendering.depth_m.ravel()[pixels], T_world_camera)
    assert len(pixels) > 100
    assert np.abs(np.linalg.norm(points - [0.1, 0.0, 0.5], axis=1) - 0.1).max() < 5e-4
    depth_m = transform_points(inverse(T_world_camera), points)[:, 2]
    assert depth_m == pytest.approx(rendering.depth_m.ravel()[pixels], abs=1e-5)


def test_rays_agree_with_the_pinhole_model(camera):
    rng = np.random.default_rng(0)
    points = rng.uniform([-0.4, -0.3, 1.0], [0.4, 0.3, 2.0], (20, 3))
    u = np.round(points[:, 0] / points[:, 2] * INTRINSICS.fx + INTRINSICS.cx).astype(int)
    v = np.round(points[:, 1] / points[:, 2] * INTRINSICS.fy + INTRINSICS.cy).astype(int)
    missed_by = camera.rays()[v, u] * points[:, 2:] - points
    assert np.abs(missed_by[:, :2]).max() <= 0.5 * 2.0 / 140.0 + 1e-6
    assert np.abs(missed_by[:, 2]).max() < 1e-6


def test_depth_agrees_with_brute_force(camera, scene):
    T_world_camera = look_at(EYE, TARGET)
    depth_m = camera.render(scene, T_world_camera).depth_m.ravel()
    pixels = np.random.default_rng(1).choice(len(depth_m), 60, replace=False)
    rays = camera.rays(R_target_camera=T_world_camera[:3, :3]).reshape(-1, 3)[pixels]
    corners = [transform_points(s.T_world_mesh, s.mesh.vertices)[s.mesh.faces] for s in scene.solids]
    expected_m = [_first_hit(EYE, ray.astype(float), np.concatenate(corners)) for ray in rays]
    assert depth_m[pixels] == pytest.approx(expected_m, abs=1e-4)


def _first_hit(origin, ray, triangles):
    """Smallest s > 0 with origin + s * ray in one of the triangles (n, 3, 3), 0 without a hit."""
    a, edge_b, edge_c = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    columns = np.stack([edge_b, edge_c, np.broadcast_to(-ray, a.shape)], axis=-1)
    facing = np.abs(np.linalg.det(columns)) > 1e-12
    b, c, s = np.linalg.solve(columns[facing], (origin - a[facing])[..., None])[..., 0].T
    hits = s[(b >= 0) & (c >= 0) & (b + c <= 1) & (s > 0)]
    return hits.min() if len(hits) else 0.0


def test_nearer_solid_hides_the_farther_one(camera):
    wall = trimesh.creation.box((2.0, 2.0, 0.01))
    scene = RayScene(
        [
            Solid(wall, make_transform(np.eye(3), [0, 0, 2.0]), 1),
            Solid(wall, make_transform(np.eye(3), [0, 0, 1.0]), 2),
        ]
    )
    rendering = camera.render(scene, np.eye(4))
    assert np.all(rendering.label == 2)
    assert np.all(rendering.solid == 1)
    assert rendering.depth_m == pytest.approx(0.995, abs=1e-5)


def test_window_is_a_crop_of_the_whole_image(camera, scene):
    T_world_camera = look_at(EYE, TARGET)
    whole = camera.render(scene, T_world_camera)
    crop = camera.render(scene, T_world_camera, window=(30, 20, 101, 77))
    for name in ("depth_m", "label", "solid", "face", "normal"):
        np.testing.assert_array_equal(getattr(crop, name), getattr(whole, name)[20:77, 30:101])


def test_window_around_an_object_holds_all_of_it(camera, scene):
    T_world_camera = look_at(EYE, TARGET)
    ball = scene.solids[1]
    points_world = transform_points(ball.T_world_mesh, ball.mesh.vertices)
    u0, v0, u1, v1 = camera.window_around(transform_points(inverse(T_world_camera), points_world))
    label = camera.render(scene, T_world_camera).label
    assert (label[v0:v1, u0:u1] == 7).sum() == (label == 7).sum()
    assert (u1 - u0) * (v1 - v0) < 2 * (label == 7).sum()


@pytest.mark.parametrize("center", [(0.0, 0.0, -1.0), (5.0, 0.0, 1.0)], ids=["behind", "beside"])
def test_window_around_what_is_out_of_sight_is_none(camera, center):
    assert camera.window_around(np.array(center) + np.eye(3) * 0.01) is None


def test_rays_into_the_void_have_no_depth(camera, scene):
    rendering = camera.render(scene, look_at(np.array([0.0, 0.0, 3.0]), np.array([0.0, 1.0, 4.0])))
    assert not rendering.depth_m.any()
    assert not rendering.label.any()
    assert np.all(rendering.solid == NOTHING)


@pytest.mark.parametrize("window", [(0, 0, 0, 10), (-1, 0, 10, 10), (0, 0, 161, 10), (5, 9, 10, 9)])
def test_window_outside_the_image_is_refused(camera, scene, window):
    with pytest.raises(ParamError, match="window"):
        camera.render(scene, np.eye(4), window)


def test_camera_without_focal_length_is_refused():
    with pytest.raises(ParamError, match="focal"):
        DepthCamera(Intrinsics(640, 480, 0.0, 600.0, 320.0, 240.0))


def test_empty_scene_is_refused():
    with pytest.raises(MeshError, match="0 solids"):
        RayScene([])
    with pytest.raises(MeshError, match="faces"):
        RayScene([Solid(trimesh.Trimesh(), np.eye(4))])


def test_look_at_is_level_and_points_at_the_target():
    T_world_camera = look_at(np.stack([EYE, EYE + 0.1]), np.stack([TARGET, TARGET]))
    for T in T_world_camera:
        in_camera = transform_points(inverse(T), TARGET)
        assert in_camera[:2] == pytest.approx(0.0, abs=1e-12)
        assert in_camera[2] > 0.0
        assert T[2, 0] == pytest.approx(0.0, abs=1e-12)  # the image's x axis is horizontal
        assert T[2, 1] < 0.0  # and its y axis points down
        assert T[:3, :3] @ T[:3, :3].T == pytest.approx(np.eye(3), abs=1e-12)
