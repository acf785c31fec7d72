import numpy as np
import pytest
import trimesh

from neuse.errors import MeshError
from neuse.geometry import make_transform
from neuse.mapping.markers import CLEAN_SHEET, MarkerKind, map_points, object_color, scene_markers
from neuse.records import ChangeKind, MapObject, ObjectChange, ObjectMap, ObjectStatus

from .synthetic import make_code, make_world, orbit, standing

MUG = standing("mug", 0.0, 0.0, category="mug")
CODE = make_code(MUG, MUG.T_world_object, np.random.default_rng(0))


def known(object_id, status=ObjectStatus.UNCHANGED, x=0.0):
    T = make_transform(np.eye(3), [x, 0.0, 0.0])
    return MapObject(object_id, "mug", status, T, T[:3, 3], np.array([0.1, 0.1, 0.2]), CODE, 0, 0, 1)


def cube(object_id):
    return trimesh.creation.box(extents=[0.1, 0.1, 0.1])


def moved(object_id, x):
    after = make_transform(np.eye(3), [x, 0.0, 0.0])
    return ObjectChange(0, ChangeKind.MOVED, object_id, "mug", np.eye(4), after)


def of_kind(markers, kind):
    return {marker.marker_id: marker for marker in markers if marker.kind == kind}


def test_each_present_object_has_a_mesh_and_a_label():
    markers = scene_markers(ObjectMap(0, (known(1), known(2, ObjectStatus.ADDED))), cube, ())
    meshes, labels = of_kind(markers, MarkerKind.MESH), of_kind(markers, MarkerKind.TEXT)
    assert set(meshes) == set(labels) == {1, 2}
    np.testing.assert_array_equal(meshes[1].points.reshape(-1, 3, 3), cube(1).triangles)
    assert (labels[1].text, labels[2].text) == ("mug 1", "mug 2 (added)")
    assert labels[1].points[0, 2] > 0.1


def test_removed_object_has_a_label_but_no_mesh_and_no_points():
    object_map = ObjectMap(0, (known(1, ObjectStatus.REMOVED),))
    markers = scene_markers(object_map, cube, ())
    assert [marker.text for marker in markers[1:]] == ["mug 1 (removed)"]
    assert len(map_points(object_map, cube)[0]) == 0


def test_latest_move_of_an_object_is_an_arrow():
    moves = (moved(1, 0.3), moved(1, 0.5), moved(9, 0.5))
    arrows = of_kind(scene_markers(ObjectMap(0, (known(1),)), cube, moves), MarkerKind.ARROW)
    np.testing.assert_array_equal(arrows[1].points, [[0, 0, 0], [0.5, 0, 0]])
    assert set(arrows) == {1}


def test_names_are_unique():
    objects = (known(1, ObjectStatus.MOVED), known(2))
    markers = scene_markers(ObjectMap(0, objects), cube, (moved(1, 0.3),))
    names = [(marker.namespace, marker.marker_id) for marker in markers]
    assert len(set(names)) == len(names) == 6


@pytest.mark.parametrize("objects", [(), (known(1), known(2))])
def test_every_drawing_begins_with_a_clean_sheet(objects):
    markers = scene_markers(ObjectMap(0, objects), cube, ())
    assert [marker is CLEAN_SHEET for marker in markers] == [True] + 2 * len(objects) * [False]


def test_object_that_cannot_be_decoded_is_drawn_as_its_box():
    def refuse(object_id):
        raise MeshError("empty")

    markers = of_kind(scene_markers(ObjectMap(0, (known(1, x=2.0),)), refuse, ()), MarkerKind.MESH)
    np.testing.assert_allclose(np.ptp(markers[1].points, axis=0), [0.1, 0.1, 0.2])
    np.testing.assert_allclose(markers[1].points.mean(axis=0), [2.0, 0.0, 0.0], atol=1e-9)


def test_points_have_the_colours_of_their_objects():
    points, colors = map_points(ObjectMap(0, (known(1), known(2))), cube)
    assert points.shape == colors.shape == (16, 3)
    np.testing.assert_array_equal(colors[0], object_color(1)[:3])
    np.testing.assert_array_equal(colors[-1], object_color(2)[:3])


def test_colours_of_many_ids_differ():
    colors = np.array([object_color(i) for i in range(20)])
    distances = np.linalg.norm(colors[:, None] - colors, axis=2) + np.eye(20)
    assert distances.min() > 0.03
    assert object_color(3) == pytest.approx(object_color(3))


def test_after_a_loop_closure_everything_is_drawn_in_place_and_no_ghost_stays():
    """The second visit starts off its place under new ids, is drawn so, and then put right."""
    off = np.array([0.0, 0.0, 0.03, 0.15, 0.05, 0.12])
    world = make_world(drift=lambda frame: off if 16 <= frame < 32 else np.zeros(6))
    viewer = {}

    def show():
        for marker in scene_markers(world.mapper.object_map, world.mapper.mesh, world.mapper.changes):
            viewer[marker.namespace, marker.marker_id] = marker
            if marker.kind == MarkerKind.DELETE_ALL:
                viewer.clear()

    world.tour(orbit(count=16))
    old_ids, world.ids = world.ids, {}
    second_visit = orbit(count=16, start_rad=1.0)
    world.tour(second_visit)
    show()
    doubled = of_kind(viewer.values(), MarkerKind.MESH)
    assert len(doubled) > len(world.things)

    world.correct([*[k.T_map_camera for k in world._keyframes[:16]], *second_visit])
    world.ids = old_ids
    world.close_loop(second_visit[0])
    show()
    meshes = of_kind(viewer.values(), MarkerKind.MESH)
    assert len(meshes) == len(of_kind(viewer.values(), MarkerKind.TEXT)) == len(world.things)
    middles = np.array([(m.points.min(axis=0) + m.points.max(axis=0)) / 2 for m in meshes.values()])
    places = np.array([thing.T_world_object[:3, 3] for thing in world.things])
    assert np.linalg.norm(places[:, None] - middles, axis=2).min(axis=1).max() < 0.02
