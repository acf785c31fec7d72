import numpy as np
import pytest
import trimesh

from neuse.errors import ParamError
from neuse.geometry import make_transform
from neuse.records import Intrinsics
from neuse.simulation.camera import DepthCamera, RayScene, Solid, look_at
from neuse.simulation.shading import AMBIENT, BACKDROP, LAMP, TILE_M, Shader, checker, wood

INTRINSICS = Intrinsics(width=80, height=60, fx=70.0, fy=70.0, cx=39.5, cy=29.5)


def plain(color):
    return lambda points: np.broadcast_to(np.uint8(color), (len(points), 3))


def picture_of(solids, paints, T_world_camera):
    camera, scene = DepthCamera(INTRINSICS), RayScene(solids)
    rendering = camera.render(scene, T_world_camera)
    return Shader(camera, scene, paints).picture(rendering, T_world_camera), rendering


def test_each_solid_has_its_paint_and_the_void_the_backdrop():
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.2)
    solids = [Solid(ball, make_transform(np.eye(3), [x, 0.0, 2.0])) for x in (-0.4, 0.4)]
    color, rendering = picture_of(solids, [plain([200, 0, 0]), plain([0, 200, 0])], np.eye(4))
    assert np.all(color[rendering.solid == 0][:, 1:] == 0)
    assert np.all(color[rendering.solid == 1][:, [0, 2]] == 0)
    assert np.all(color[rendering.solid == -1] == BACKDROP)


def test_brightness_follows_the_cosine_law():
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    T_world_camera = look_at(np.array([2.0, 1.5, 2.0]), np.zeros(3))
    color, rendering = picture_of([Solid(box, np.eye(4))], [plain([200, 200, 200])], T_world_camera)
    for axis in range(3):
        seen = (rendering.solid == 0) & (np.argmax(np.abs(rendering.normal), axis=2) == axis)
        expected = 200 * (AMBIENT + (1 - AMBIENT) * max(LAMP[axis], 0.0))
        assert color[seen] == pytest.approx(expected, abs=1.0)


def test_texture_moves_with_its_solid():
    plate = trimesh.creation.box((1.0, 1.0, 0.01))
    paint = checker((0, 0, 0), (255, 255, 255))
    T_world_camera = look_at(np.array([0.1, -1.0, 1.0]), np.zeros(3))
    moved = make_transform(np.eye(3), [0.37, 0.21, 0.05])
    before, _ = picture_of([Solid(plate, np.eye(4))], [paint], T_world_camera)
    after, _ = picture_of([Solid(plate, moved)], [paint], moved @ T_world_camera)
    assert np.mean(before != after) < 0.01  # float rounding at the borders of squares


def test_checker_alternates():
    paint = checker((0, 0, 0), (9, 9, 9), side_m=TILE_M / 8)
    along = (np.arange(-16, 16) + 0.5) * TILE_M / 8
    values = paint(np.stack([along, 0 * along + 0.01, 0 * along], axis=1).astype(np.float32))[:, 0]
    assert list(values) == [0, 9] * 16


def test_wood_has_tones_of_one_colour():
    points = np.random.default_rng(0).uniform(-1, 1, (1000, 3)).astype(np.float32)
    colors = wood((200, 100, 50))(points).astype(float)
    assert colors[:, 0].std() > 5.0
    assert colors[:, 0] / colors[:, 1] == pytest.approx(2.0, abs=0.05)


def test_paints_must_match_the_solids():
    scene = RayScene([Solid(trimesh.creation.box(), np.eye(4))])
    with pytest.raises(ParamError, match="1 solids need as many paints, got 2"):
        Shader(DepthCamera(INTRINSICS), scene, [plain([0, 0, 0])] * 2)
