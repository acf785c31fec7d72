import numpy as np
import pytest
import torch
import trimesh

import neuse
from neuse.embedding import embedding as embedding_module
from neuse.embedding.embedding import MIN_POINTS, SIGMA_FLOOR, Embedding, load_embedding
from neuse.embedding.network import UNIT_M, save_network
from neuse.errors import InputError, WeightsError
from neuse.geometry import transform_points
from neuse.simulation.shapes import sample_shape

from .tiny import make_code, make_network, partial_cloud, random_transform

SIZES = (MIN_POINTS, 63, 64, 65, 700)  # the network takes 64


EYE = np.array([0.7, 0.4, 0.6])  # object frame, metres


def spread(z):
    return np.linalg.norm(z - z.mean(axis=0))


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("seed", range(4))
def test_code_moves_with_the_cloud(embedding, n, seed):
    rng = np.random.default_rng([seed, n])
    cloud, T = partial_cloud(rng, n), random_transform(rng, reach_m=10.0)
    code, moved = embedding.encode([cloud, transform_points(T, cloud)])
    expected = code.transformed(T)
    assert np.linalg.norm(moved.z - expected.z) <= 1e-4 * spread(code.z)
    np.testing.assert_allclose(moved.descriptor, code.descriptor, atol=1e-4)
    np.testing.assert_allclose(moved.sigmas, code.sigmas, rtol=1e-4)


def test_translation_alone_moves_the_code_by_just_that(embedding):
    cloud, shift = partial_cloud(np.random.default_rng(0), 200), np.array([4.0, -3.0, 9.0])
    code, moved = embedding.encode([cloud, cloud + shift])
    np.testing.assert_allclose(moved.z - code.z, np.tile(shift, (len(code.z), 1)), atol=1e-6)


def test_different_clouds_have_different_codes(embedding):
    rng = np.random.default_rng(1)
    a, b = embedding.encode([partial_cloud(rng, 100), partial_cloud(rng, 100) * [1.0, 1.0, 2.0]])
    assert np.linalg.norm(a.z - b.z) > 1e-3 * spread(a.z)
    assert np.abs(a.descriptor - b.descriptor).max() > 1e-4


def test_codes_do_not_depend_on_what_else_is_in_the_batch(embedding):
    rng = np.random.default_rng(2)
    clouds = [partial_cloud(rng, n) for n in (20, 64, 300)]
    for together, cloud in zip(embedding.encode(clouds), clouds, strict=True):
        (alone,) = embedding.encode([cloud])
        np.testing.assert_allclose(together.z, alone.z, atol=1e-6)
        np.testing.assert_allclose(together.descriptor, alone.descriptor, atol=1e-5)


def test_an_embedding_that_was_prepared_gives_the_same_codes(network):
    cloud = partial_cloud(np.random.default_rng(3), 100)
    fresh, prepared = Embedding(network), Embedding(network)
    prepared.prepare()
    (a,), (b,) = fresh.encode([cloud]), prepared.encode([cloud])
    np.testing.assert_array_equal(a.z, b.z)


def mug_cloud(rng, n=500):
    """(n, 3) the side of an unseen mug that faces the camera, a metre away."""
    mesh = sample_shape("mug", rng, "test").mesh
    points, faces = trimesh.sample.sample_surface(mesh, 4 * n, seed=int(rng.integers(2**31)))
    faces_camera = ((EYE - points) * mesh.face_normals[faces]).sum(axis=1) > 0
    return points[faces_camera][:n] - EYE


def test_share_of_the_points_gives_nearly_the_same_code():
    embedding, rng = load_embedding("mug"), np.random.default_rng(4)
    clouds = [mug_cloud(rng) for _ in range(8)]
    whole, half = embedding.encode(clouds), embedding.encode(clouds, share=0.5)
    moved = embedding.encode([cloud + 3.0 for cloud in clouds], share=0.5)
    changes = [np.linalg.norm(a.z - b.z) / spread(a.z) for a, b in zip(whole, half, strict=True)]
    assert 0.01 < np.median(changes) < 0.15
    assert max(changes) < 0.3
    for b, c in zip(half, moved, strict=True):
        np.testing.assert_allclose(c.z - 3.0, b.z, atol=1e-6)


def test_encoding_twice_gives_the_same_bits(embedding):
    cloud = partial_cloud(np.random.default_rng(3), 500)
    (a,), (b,) = embedding.encode([cloud]), embedding.encode([cloud])
    np.testing.assert_array_equal(a.z, b.z)


def test_code_carries_category_and_units(embedding):
    code = embedding.encode([partial_cloud(np.random.default_rng(4), 100)])[0]
    k = embedding.network.config.n_latent
    assert (code.category, code.ambiguous) == (embedding.category, embedding.ambiguous)
    assert code.z.shape == (k, 3)
    assert code.z.dtype == code.descriptor.dtype == code.sigmas.dtype == np.float64
    assert np.linalg.norm(code.descriptor) == pytest.approx(1.0, abs=1e-6)


def test_clouds_may_be_lists_of_lists_or_single_precision(embedding):
    cloud = partial_cloud(np.random.default_rng(5), 30).astype(np.float32)
    a, b = embedding.encode([cloud, cloud.tolist()])
    np.testing.assert_array_equal(a.z, b.z)


def test_no_clouds_give_no_codes(embedding):
    assert embedding.encode([]) == []


def test_cloud_of_one_repeated_point_has_a_finite_code(embedding):
    code = embedding.encode([np.full((MIN_POINTS, 3), 0.5)])[0]
    for array in (code.z, code.descriptor, code.sigmas, code.T_frame_object):
        assert np.isfinite(array).all()


@pytest.mark.parametrize(
    ("cloud", "reason"),
    [
        (np.zeros((20, 2)), "cloud_shape"),
        (np.zeros(30), "cloud_shape"),
        (np.zeros((MIN_POINTS - 1, 3)), "too_few_points"),
        (np.zeros((0, 3)), "too_few_points"),
        (np.full((20, 3), np.nan), "not_finite"),
        (np.full((20, 3), np.inf), "not_finite"),
    ],
)
def test_cloud_that_cannot_be_used_is_refused_by_its_index(embedding, cloud, reason):
    good = partial_cloud(np.random.default_rng(6), 50)
    with pytest.raises(InputError, match="cloud 1 has") as caught:
        embedding.encode([good, cloud])
    assert caught.value.reason == reason


def with_log_sigmas(value, category="mug"):
    """An embedding whose network always predicts this log sigma, in network units."""
    network = make_network(category)
    torch.nn.init.zeros_(network.encoder.to_sigmas[-1].weight)
    torch.nn.init.constant_(network.encoder.to_sigmas[-1].bias, value)
    return Embedding(network)


def test_sigmas_are_in_radians_and_metres_and_calibrated():
    embedding = with_log_sigmas(np.log(0.05))
    embedding.network.sigma_scale.copy_(torch.tensor([1.0, 2.0, 3.0, 1.0, 2.0, 3.0, 1.0]))
    (code,) = embedding.encode([partial_cloud(np.random.default_rng(7), 50)])
    along_axis = np.hypot(3, 1) / 2  # of the middle between top and bottom
    expected = 0.05 * np.array([1, 2, 3, UNIT_M, 2 * UNIT_M, along_axis * UNIT_M])
    np.testing.assert_allclose(code.sigmas, expected, rtol=1e-5)
    assert code.height_correlation == pytest.approx((9 - 1) / (9 + 1))


@pytest.mark.parametrize("category", ["mug", "bottle"])
@pytest.mark.parametrize("log_sigma", [-100.0, 100.0])
def test_sigmas_stay_believable_whatever_the_network_says(category, log_sigma):
    (code,) = with_log_sigmas(log_sigma, category).encode([partial_cloud(np.random.default_rng(8), 50)])
    assert (code.sigmas[:5] >= SIGMA_FLOOR[:5]).all()
    assert code.sigmas[5] >= np.hypot(*SIGMA_FLOOR[5:]) / 2 * (1 - 1e-9)
    assert abs(code.height_correlation) <= 1.0
    assert (code.sigmas[:3] <= np.pi).all()
    assert np.isfinite(code.sigmas).all()


def test_turn_about_the_axis_of_an_ambiguous_object_is_unknown():
    (code,) = with_log_sigmas(-3.0, "bottle").encode([partial_cloud(np.random.default_rng(9), 50)])
    assert code.sigmas[2] == np.pi
    assert code.sigmas[1] < 0.1


def test_frame_of_a_box_tells_its_centre_and_no_rotation():
    (code,) = with_log_sigmas(-3.0, "box").encode([partial_cloud(np.random.default_rng(9), 50)])
    assert not code.ambiguous
    assert (code.sigmas[:3] == np.pi).all()
    assert (code.sigmas[3:] < 0.1).all()
    assert code.height_correlation == 0.0


@pytest.fixture
def shipped(tmp_path, monkeypatch):
    """A folder of shipped weights that holds a mug, and a bottle under the wrong name."""
    save_network(make_network("mug"), tmp_path / "mug.safetensors", {})
    save_network(make_network("mug"), tmp_path / "bottle.safetensors", {})
    monkeypatch.setattr(embedding_module, "WEIGHTS", tmp_path)
    return tmp_path


def test_embedding_is_loaded_by_category(shipped):
    assert neuse.load_embedding("mug").category == "mug"


@pytest.mark.parametrize("as_type", [str, lambda path: path], ids=["str", "Path"])
def test_embedding_is_loaded_from_a_file(shipped, as_type):
    assert load_embedding(as_type(shipped / "mug.safetensors")).category == "mug"


def test_unknown_category_is_refused_with_those_that_are_shipped(shipped):
    with pytest.raises(WeightsError, match=r"'teapot'; shipped: bottle, mug"):
        load_embedding("teapot")


def test_shipped_file_of_another_category_is_refused(shipped):
    with pytest.raises(WeightsError, match="'mug', not 'bottle'"):
        load_embedding("bottle")


def test_missing_file_is_refused(tmp_path):
    with pytest.raises(WeightsError, match="cannot read"):
        load_embedding(tmp_path / "mug.safetensors")


def test_code_of_another_category_is_not_decoded():
    with pytest.raises(InputError, match="mug decoder was given the code of a bottle") as caught:
        Embedding(make_network("mug")).reconstruct(make_code(np.eye(4), "bottle"))
    assert caught.value.reason == "category"


def test_code_of_another_size_is_not_decoded():
    with pytest.raises(InputError, match="32 latent points") as caught:
        Embedding(make_network("mug")).reconstruct(make_code(np.eye(4), k=32))
    assert caught.value.reason == "code_size"


@pytest.mark.parametrize("resolution_m", [0.0, -0.001, np.nan, np.inf])
def test_resolution_that_makes_no_grid_is_refused(resolution_m):
    with pytest.raises(InputError, match="resolution_m") as caught:
        Embedding(make_network("mug")).reconstruct(make_code(np.eye(4)), resolution_m)
    assert caught.value.reason == "resolution"
