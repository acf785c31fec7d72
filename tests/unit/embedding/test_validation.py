import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from torch.nn import functional as F

from neuse.embedding import validation
from neuse.embedding.encoder import Encoding
from neuse.embedding.network import UNIT_M
from neuse.embedding.validation import decode_all, encode_all, equal_error_rate, validate

from .tiny import make_network


@pytest.fixture
def answers(monkeypatch):
    """Replaces the network's answers by the truth, turned and shifted."""

    def install(turn_deg=0.0, shift_m=0.0):
        R = torch.tensor(Rotation.from_euler("y", turn_deg, degrees=True).as_matrix(), dtype=torch.float32)

        def encode(network, views, n_views):
            _, batch = encode_all(network, views, n_views)
            frame = torch.cat([batch.target[..., :1] + shift_m / UNIT_M, R @ batch.target[..., 1:]], -1)
            one_hot = F.one_hot(batch.shape, 16).float()
            return Encoding(torch.zeros(len(frame), 3, 16), frame, one_hot, torch.zeros(len(frame), 6)), batch

        monkeypatch.setattr(validation, "encode_all", encode)
        monkeypatch.setattr(
            validation, "decode_all", lambda network, encoding, batch: batch.occupied.float() - 0.5
        )

    return install


def test_true_answers_have_perfect_figures(answers, mug_views):
    answers()
    figures = validate(make_network("mug"), mug_views)
    assert figures.pop("iou") == 1.0
    np.testing.assert_allclose(list(figures.values()), 0.0, atol=0.03)


def test_figures_are_degrees_and_millimetres(answers, mug_views):
    answers(turn_deg=10.0, shift_m=0.003)
    figures = validate(make_network("mug"), mug_views)
    assert figures["deg_all"] == pytest.approx(10.0, abs=0.01)
    assert figures["deg_seen_p90"] == pytest.approx(10.0, abs=0.01)
    assert figures["mm_all"] == pytest.approx(3.0 * np.sqrt(3), abs=0.01)


def test_figures_without_a_well_seen_view_are_not_a_number(answers, mug_views, monkeypatch):
    answers()
    monkeypatch.setattr(validation, "HANDLE_SEEN", 1.0)
    figures = validate(make_network("mug"), mug_views)
    assert np.isnan([figures["deg_seen"], figures["deg_seen_p90"], figures["mm_seen"]]).all()
    assert np.isfinite(figures["deg_all"])


def test_chunks_do_not_change_the_answers(mug_views):
    network = make_network("mug")
    (whole, batch), (parts, _) = (encode_all(network, mug_views, 10, chunk) for chunk in (64, 3))
    for a, b in zip(whole, parts, strict=True):
        torch.testing.assert_close(a, b, atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(
        decode_all(network, whole, batch), decode_all(network, whole, batch, chunk=3), atol=1e-5, rtol=1e-4
    )


def test_decoding_is_relative_to_the_centre_of_the_code(mug_views):
    network = make_network("mug")
    encoding, batch = encode_all(network, mug_views, 3)
    x = batch.queries[1] - encoding.frame[1, :, 0]
    z = encoding.z[1] - encoding.frame[1, :, :1]
    with torch.no_grad():
        expected = network.decoder(x[None], z[None])[0]
    torch.testing.assert_close(decode_all(network, encoding, batch)[1], expected, atol=1e-5, rtol=1e-4)


def test_equal_error_rate_of_separated_descriptors_is_zero():
    shape = np.repeat(np.arange(4), 3)
    assert equal_error_rate(np.eye(4)[shape], shape) == 0.0


def test_equal_error_rate_of_descriptors_that_know_nothing_is_a_half():
    rng = np.random.default_rng(0)
    descriptor = rng.normal(size=(300, 32))
    descriptor /= np.linalg.norm(descriptor, axis=1, keepdims=True)
    assert equal_error_rate(descriptor, rng.integers(0, 10, 300)) == pytest.approx(0.5, abs=0.05)


def test_equal_error_rate_is_where_both_errors_meet():
    rng = np.random.default_rng(1)
    shape = rng.integers(0, 6, 60)
    descriptor = np.eye(6)[shape] + rng.normal(scale=0.4, size=(60, 6))
    descriptor /= np.linalg.norm(descriptor, axis=1, keepdims=True)
    pairs = np.triu_indices(60, 1)
    similarity, same = (descriptor @ descriptor.T)[pairs], (shape[:, None] == shape)[pairs]
    gates = np.sort(similarity)
    refused = np.searchsorted(np.sort(similarity[same]), gates) / same.sum()
    accepted = 1 - np.searchsorted(np.sort(similarity[~same]), gates) / (~same).sum()
    meeting = np.abs(refused - accepted).argmin()
    assert 0.02 < accepted[meeting] < 0.4
    assert equal_error_rate(descriptor, shape) == pytest.approx(accepted[meeting], abs=0.01)
