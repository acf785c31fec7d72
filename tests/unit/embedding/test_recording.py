import pytest
import torch

from neuse.embedding.recording import RecordedEncoder

from .tiny import CONFIG


@torch.inference_mode()
@pytest.mark.parametrize(("clouds", "n_anchors"), [(1, CONFIG.n_anchors), (5, CONFIG.n_anchors), (3, 8)])
def test_a_recorded_encoder_gives_what_the_encoder_gives(network, clouds, n_anchors):
    points = torch.randn(clouds, CONFIG.n_points, 3, dtype=torch.float64)
    torch.testing.assert_close(
        RecordedEncoder(network.encoder)(points, n_anchors), network.encode(points, n_anchors)
    )


@torch.inference_mode()
def test_a_recorded_encoder_has_the_weights_that_the_encoder_has_now(network):
    points = torch.randn(2, CONFIG.n_points, 3, dtype=torch.float64)
    recorded = RecordedEncoder(network.encoder)
    before = recorded(points, 8)
    network.encoder.to_frame.weight.mul_(2.0)
    torch.testing.assert_close(recorded(points, 8).frame, 2.0 * before.frame)
