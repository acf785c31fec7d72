import numpy as np
import pytest

from neuse.embedding.sightings import Condition, draw_sightings

from .test_observe import FakeEmbedding
from .tiny import block_bottle, block_mug, distance_to_surface

NEAR = (0.6, 0.9)
CONDITIONS = (
    Condition("clean", 0.0, range_m=NEAR),
    Condition("noisy", 0.003, range_m=NEAR),
    Condition("farther", 0.0015, growing=True, range_m=(1.5, 1.8)),
)


@pytest.fixture(scope="module")
def drawn():
    """[(condition, sightings)] of one scene in two views, with the clouds that were encoded."""
    shapes = {"mug": [block_mug(), block_mug()], "bottle": [block_bottle(), block_bottle()]}
    embeddings = {category: FakeEmbedding(category) for category in shapes}
    rng = np.random.default_rng(3)
    return list(draw_sightings(shapes, embeddings, CONDITIONS, 1, 2, rng))


def by_name(drawn):
    return {condition.name: sightings for condition, sightings in drawn}


def test_every_condition_is_drawn_once_a_scene(drawn):
    assert sorted(condition.name for condition, _ in drawn) == ["clean", "farther", "noisy"]


def test_conditions_of_one_range_share_their_poses(drawn):
    found = by_name(drawn)
    clean, noisy = ({(s.view, id(s.shape)): s for s in found[name]} for name in ("clean", "noisy"))
    shared = clean.keys() & noisy.keys()
    assert len(shared) >= 4
    for key in shared:
        np.testing.assert_array_equal(clean[key].T_camera_object, noisy[key].T_camera_object)


def test_true_pose_is_that_of_the_object_that_was_seen(drawn):
    for sighting in by_name(drawn)["clean"]:
        seen = sighting.code.center[None]  # of the fake: the mean of the points, so within the object's box
        T = sighting.T_camera_object
        inside = (seen - T[:3, 3]) @ T[:3, :3]
        assert distance_to_surface(sighting.shape.mesh, inside).max() < 0.05
        assert np.abs(inside).max() < sighting.shape.mesh.extents.max()


def test_sightings_state_range_and_visibility(drawn):
    for condition, sightings in drawn:
        assert sightings
        for sighting in sightings:
            assert condition.range_m[0] - 0.4 < sighting.range_m < condition.range_m[1] + 0.4
            assert 0.0 < sighting.visible <= 1.0
            assert 0.0 <= sighting.handle <= 1.0
            assert sighting.handle == 0.0 or sighting.shape.category == "mug"


@pytest.mark.parametrize("range_m", [0.5, 1.0, 3.0])
def test_noise_is_constant_or_grows_with_range_squared(range_m):
    constant, growing = (
        Condition("c", 0.0015).faults(range_m),
        Condition("g", 0.0015, growing=True).faults(range_m),
    )
    assert constant.noise_m_at_1m * range_m**2 == pytest.approx(0.0015)
    assert growing.noise_m_at_1m == 0.0015


def test_masks_are_faulty_only_where_asked_for():
    plain, faulty = (Condition("x", 0.001, mask_faults=on).faults(1.0) for on in (False, True))
    assert (plain.erosion_px, plain.cut_rate, plain.miss_rate) == (0, 0.0, 0.0)
    assert min(faulty.erosion_px, faulty.cut_rate, faulty.miss_rate) > 0
