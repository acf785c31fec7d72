import torch
from scipy.spatial.transform import Rotation

from neuse.embedding.encoder import pool_vectors

from .tiny import CONFIG


def clouds(n=3):
    torch.manual_seed(1)
    return torch.randn(n, CONFIG.n_points, 3, dtype=torch.float64) * torch.tensor([0.5, 0.3, 0.4])


def test_pooling_is_the_weighted_mean_over_the_points():
    weights, vectors = torch.randn(2, 7, 4), torch.randn(2, 7, 3, 5)
    expected = torch.einsum("bmw,bmiv->biwv", weights, vectors).flatten(2) / 7
    torch.testing.assert_close(pool_vectors(weights, vectors.flatten(2)), expected)


@torch.no_grad()
def test_encoding_has_the_documented_shapes(network):
    encoding = network.encode(clouds(3))
    assert encoding.frame.shape == (3, 3, 4)
    assert encoding.z.shape == (3, 3, CONFIG.n_latent)
    assert encoding.descriptor.shape == (3, CONFIG.n_latent)
    assert encoding.log_sigmas.shape == (3, 7)
    torch.testing.assert_close(encoding.descriptor.norm(dim=-1), torch.ones(3))


@torch.no_grad()
def test_encoder_turns_frames_with_the_cloud_and_keeps_numbers(network):
    points = clouds()
    encoding = network.encode(points)
    for matrix in Rotation.random(5, random_state=0).as_matrix():
        R = torch.tensor(matrix)
        turned = network.encode(points @ R.T)
        for name in ("frame", "z"):
            expected = R.float() @ getattr(encoding, name)
            assert (getattr(turned, name) - expected).norm() <= 1e-4 * expected.norm()
        torch.testing.assert_close(turned.descriptor, encoding.descriptor, atol=1e-4, rtol=1e-4)
        torch.testing.assert_close(turned.log_sigmas, encoding.log_sigmas, atol=1e-4, rtol=1e-4)


@torch.no_grad()
def test_only_an_ambiguous_object_has_no_axes_across(network):
    across = network.encode(clouds()).frame[..., 1:3]
    assert bool((across == 0).all()) == network.ambiguous


def test_uncertainty_does_not_train_the_features_it_reads(network):
    network.encode(clouds()).log_sigmas.sum().backward()
    trained = {name for name, weight in network.named_parameters() if weight.grad is not None}
    assert trained
    assert all(name.startswith("encoder.to_sigmas") for name in trained)


@torch.no_grad()
def test_fewer_anchors_can_be_asked_for(network):
    few, all_anchors = network.encode(clouds(), 8), network.encode(clouds())
    assert few.frame.shape == all_anchors.frame.shape
    assert not torch.equal(few.frame, all_anchors.frame)
