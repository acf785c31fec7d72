import pytest
import torch
from scipy.spatial.transform import Rotation

from neuse.embedding.layers import ResnetBlockFC, VNLeakyReLU, VNLinear, VNResnetBlock


@pytest.fixture
def v():
    torch.manual_seed(0)
    return torch.randn(2, 5, 3, 8)


def rotations(n):
    return torch.tensor(Rotation.random(n, random_state=0).as_matrix(), dtype=torch.float32)


@pytest.mark.parametrize(
    "layer", [VNLinear(8, 4), VNLeakyReLU(8), VNResnetBlock(8, 6)], ids=lambda layer: type(layer).__name__
)
def test_vector_neurons_turn_with_their_input(layer, v):
    for R in rotations(5):
        turned, expected = layer(R @ v), R @ layer(v)
        assert (turned - expected).norm() <= 1e-5 * expected.norm()


def test_linear_layer_starts_with_outputs_of_the_size_of_its_inputs():
    torch.manual_seed(0)
    with torch.no_grad():
        out = VNLinear(256, 256)(torch.randn(64, 3, 256))
    assert 0.8 < float(out.std()) < 1.2


def test_linear_layer_stays_in_float32_under_autocast(v):
    layer = VNLinear(8, 4)
    with torch.autocast("cpu", torch.bfloat16):
        out = layer(v)
    assert out.dtype == torch.float32
    torch.testing.assert_close(out, layer(v), rtol=0, atol=0)


def test_activation_passes_vectors_on_the_side_of_its_direction(v):
    activation = VNLeakyReLU(8)
    activation.direction.weight.data = torch.eye(8)  # every vector is its own direction
    torch.testing.assert_close(activation(v), v)


def test_activation_shortens_what_points_against_its_direction(v):
    activation = VNLeakyReLU(8, slope=0.2)
    activation.direction.weight.data = -torch.eye(8)
    torch.testing.assert_close(activation(v), 0.2 * v, rtol=1e-4, atol=1e-4)


def test_activation_without_slope_leaves_nothing_against_its_direction(v):
    activation = VNLeakyReLU(8, slope=0.0)
    along = (activation(v) * activation.direction(v)).sum(-2)
    assert float(along.min()) >= -1e-4


@torch.no_grad()
def test_decoder_block_starts_as_a_constant_shift():
    block, x = ResnetBlockFC(16), torch.randn(4, 16)
    torch.testing.assert_close(block(x), x + block.outer.bias)
