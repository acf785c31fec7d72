import pytest
import torch
from scipy.spatial.transform import Rotation

from neuse.embedding.decoder import CHUNK

from .tiny import CONFIG, make_network


@pytest.fixture
def decoder():
    return make_network().decoder


@pytest.fixture
def x():
    torch.manual_seed(2)
    return torch.randn(2, 9, 3)


@pytest.fixture
def z():
    torch.manual_seed(3)
    return torch.randn(2, 3, CONFIG.n_latent)


@torch.no_grad()
def test_first_layer_equals_the_naive_product_with_every_latent_point(decoder, x, z):
    products = torch.einsum("bqi,bik->bqk", x, z)  # <x, z_j>
    invariants = torch.einsum("bik,bik->bk", z, decoder.partner(z))
    h = decoder.of_products(products) + decoder.of_invariants(invariants)[:, None]
    h = h + decoder.of_norm((x**2).sum(-1, keepdim=True))
    for block in decoder.blocks:
        h = block(h)
    expected = decoder.to_logit(torch.relu(h))[..., 0]
    torch.testing.assert_close(decoder(x, z), expected, atol=1e-5, rtol=1e-5)


@torch.no_grad()
def test_occupancy_does_not_change_when_point_and_code_turn_together(decoder, x, z):
    for matrix in Rotation.random(5, random_state=0).as_matrix():
        R = torch.tensor(matrix, dtype=torch.float32)
        torch.testing.assert_close(decoder(x @ R.T, R @ z), decoder(x, z), atol=1e-5, rtol=1e-4)


@torch.no_grad()
def test_queries_are_decoded_independently(decoder, x, z):
    torch.testing.assert_close(decoder(x[:, 4:5], z), decoder(x, z)[:, 4:5])


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 1e-5), (torch.bfloat16, 0.03)])
@torch.no_grad()
def test_many_points_of_one_code_decode_as_in_a_batch(decoder, z, dtype, tolerance):
    for parameter in decoder.blocks.parameters():  # of which some are zero before training
        torch.nn.init.normal_(parameter, std=0.1)
    x = torch.randn(CHUNK + 10, 3)  # more than one chunk
    expected = decoder(x[None], z[:1])[0]
    found = decoder.evaluate(x, z[0], dtype)
    assert found.dtype == torch.float32
    assert (found - expected).norm() <= tolerance * expected.norm()
