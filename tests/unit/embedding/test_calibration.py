import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from neuse.embedding import calibration
from neuse.embedding.calibration import calibrate
from neuse.embedding.dataset import Batch
from neuse.embedding.encoder import Encoding

from .tiny import make_network

N = 4000
PREDICTED = 0.05


@pytest.fixture
def held_out(monkeypatch):
    """Held-out answers with errors of chosen standard deviations, (7,), and logits off by `bias`."""

    def install(sigmas, bias=0.0):
        rng = np.random.default_rng(0)
        errors = rng.normal(size=(N, 7)) * sigmas
        R_target = Rotation.random(N, random_state=1)
        R = R_target * Rotation.from_rotvec(errors[:, :3]).inv()
        top, bottom = errors[:, 5], errors[:, 6]
        center = -R.apply(np.column_stack([errors[:, 3:5], (top + bottom) / 2]))
        axes = R.as_matrix() * np.stack([np.ones(N), np.ones(N), 1 - (top - bottom) / 2], -1)[:, None]
        frame = torch.tensor(np.concatenate([center[..., None], axes], -1))
        target = torch.tensor(np.concatenate([np.zeros((N, 3, 1)), R_target.as_matrix()], -1))
        occupied = torch.tensor(rng.random((N, 4)) < 0.4)
        logits = torch.where(occupied, 1.0, -1.0) * torch.tensor(rng.random((N, 4))) + bias
        nothing = torch.empty(N)
        encoding = Encoding(nothing, frame, nothing, torch.full((N, 7), float(np.log(PREDICTED))))
        batch = Batch(nothing, target, nothing, nothing, occupied, nothing, nothing)
        monkeypatch.setattr(calibration, "encode_all", lambda *arguments: (encoding, batch))
        monkeypatch.setattr(calibration, "decode_all", lambda *arguments: logits)

    return install


def test_predicted_sigmas_become_the_spread_of_the_errors(held_out):
    factors = np.array([0.5, 1.0, 2.0, 0.7, 1.5, 3.0, 0.8])
    held_out(PREDICTED * factors)
    network = make_network("mug")
    calibrate(network, views=None)
    np.testing.assert_allclose(network.sigma_scale, factors, rtol=0.06)


def test_few_flipped_frames_do_not_inflate_the_sigmas(held_out, monkeypatch):
    held_out(np.full(7, PREDICTED))
    encoding, _ = calibration.encode_all()
    encoding.frame[: N // 50, :, 1:3] *= -1.0
    network = make_network("mug")
    calibrate(network, views=None)
    np.testing.assert_allclose(network.sigma_scale, 1.0, rtol=0.1)


@pytest.mark.parametrize(("factor", "limit"), [(0.01, 0.3), (8.0, 5.0)])
def test_scale_of_the_sigmas_is_limited(held_out, factor, limit):
    held_out(np.full(7, PREDICTED * factor))
    network = make_network("mug")
    calibrate(network, views=None)
    np.testing.assert_allclose(network.sigma_scale, limit)


@pytest.mark.parametrize("bias", [-1.2, -0.5, 0.0])
def test_occupancy_threshold_is_where_the_overlap_is_best(held_out, bias):
    held_out(np.full(7, PREDICTED), bias)
    network = make_network("mug")
    calibrate(network, views=None)
    assert float(network.occupancy_logit) == pytest.approx(bias, abs=0.051)
