import numpy as np
import pytest
import torch
from scipy import stats
from scipy.spatial.transform import Rotation
from torch.autograd import gradcheck
from torch.nn import functional as F

from neuse.embedding.dataset import Batch
from neuse.embedding.encoder import Encoding
from neuse.embedding.losses import (
    FrameError,
    frame_error,
    frame_loss,
    nearest_equivalent,
    occupancy_loss,
    orthonormal,
    rotation_vector,
    shape_contrast_loss,
    shipped_losses,
    sigma_loss,
)
from neuse.symmetry import BOX, NONE

SHAPES = torch.tensor([0, 0, 1, 1, 2, 2])


def normal(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def descriptors():
    return F.normalize(normal(len(SHAPES), 8), dim=-1)


def frames(R, centers, extents=(0.7, 0.4, 0.5)):
    """(B, 3, 4) centre and scaled axes."""
    axes = np.asarray(R) * np.asarray(extents)
    return torch.tensor(np.concatenate([np.asarray(centers)[..., None], axes], -1))


def differentiable(loss, *inputs):
    return gradcheck(loss, [x.clone().requires_grad_() for x in inputs])


def test_gradients_agree_with_finite_differences():
    target, occupied = normal(3, 3, 4, seed=1), normal(2, 5, seed=2) > 0
    error = FrameError(normal(4, 3, seed=3), normal(4, 3, seed=4), normal(4, seed=5))
    assert differentiable(lambda frame: frame_loss(frame, target), normal(3, 3, 4))
    assert differentiable(lambda logits: occupancy_loss(logits, occupied), normal(2, 5))
    assert differentiable(lambda s: shape_contrast_loss(F.normalize(s, dim=-1), SHAPES), normal(6, 8))
    assert differentiable(lambda log_sigmas: sigma_loss(log_sigmas, error, False), normal(4, 7))


def test_frame_loss_is_zero_at_the_truth_with_a_finite_gradient():
    target = normal(2, 3, 4)
    frame = target.clone().requires_grad_()
    loss = frame_loss(frame, target)
    loss.backward()
    assert abs(float(loss)) < 1e-12
    assert float(frame.grad.abs().max()) < 1e-12


def test_frame_loss_of_a_large_error_is_its_length():
    target = torch.zeros(1, 3, 4, dtype=torch.float64)
    frame = target.clone()
    frame[0, :, 1] = torch.tensor([3.0, 0.0, 4.0])
    assert float(frame_loss(frame, target)) == pytest.approx(5.0, abs=0.03)


@pytest.mark.parametrize("largest_rad", [1e-4, 1.0, 3.1])
def test_frame_error_is_the_rotation_and_translation_to_the_truth(largest_rad):
    rng = np.random.default_rng(0)
    omega = rng.normal(size=(20, 3))
    omega *= largest_rad / np.linalg.norm(omega, axis=1, keepdims=True)
    R = Rotation.random(20, random_state=1)
    shift, centers = rng.normal(size=(20, 3)), rng.normal(size=(20, 3))
    predicted = frames(R.as_matrix(), centers)
    target = frames((R * Rotation.from_rotvec(omega)).as_matrix(), centers + R.apply(shift))
    error = frame_error(predicted, target, ambiguous=False)
    np.testing.assert_allclose(error.rotation, omega, atol=1e-9)
    np.testing.assert_allclose(error.translation, shift, atol=1e-9)


def test_frame_error_of_an_ambiguous_object_is_the_shortest_turn_of_its_axis():
    R, R_target = (Rotation.random(20, random_state=seed) for seed in (1, 2))
    predicted, target = (
        frames(R.as_matrix(), np.zeros((20, 3))),
        frames(R_target.as_matrix(), np.zeros((20, 3))),
    )
    error = frame_error(predicted, target, ambiguous=True).rotation.numpy()
    z, z_target = R.as_matrix()[..., 2], R_target.as_matrix()[..., 2]
    angles = np.arccos((z * z_target).sum(-1))
    np.testing.assert_allclose(np.linalg.norm(error, axis=1), angles, atol=1e-9)
    np.testing.assert_array_equal(error[:, 2], 0.0)
    R_predicted = Rotation.from_matrix(orthonormal(predicted, True).numpy())
    turned = (R_predicted * Rotation.from_rotvec(error)).as_matrix()[..., 2]
    np.testing.assert_allclose(turned, z_target, atol=1e-9)


def test_an_end_in_its_place_has_no_error_however_long_the_object_is_taken_for():
    R, top = Rotation.random(5, random_state=4).as_matrix(), torch.ones(5, 3, 1, dtype=torch.float64)
    predicted, target = (
        torch.cat([top - half * torch.from_numpy(R)[..., 2:], half * torch.from_numpy(R)], -1)
        for half in (0.5, 0.8)
    )
    components = frame_error(predicted, target, ambiguous=True).components.numpy()
    np.testing.assert_allclose(components[:, :6], 0.0, atol=1e-7)
    np.testing.assert_allclose(components[:, 6], -0.6)  # the bottom is lower than it was thought to be


def test_a_turn_about_the_axis_of_an_ambiguous_object_is_no_error():
    R = Rotation.random(10, random_state=3)
    turned = R * Rotation.from_euler("z", np.linspace(0.1, 3.0, 10)[:, None])
    centers = np.ones((10, 3))
    error = frame_error(frames(R.as_matrix(), centers), frames(turned.as_matrix(), centers), ambiguous=True)
    np.testing.assert_allclose(error.rotation, 0.0, atol=1e-6)
    np.testing.assert_allclose(error.translation, 0.0, atol=1e-12)


@pytest.mark.parametrize("ambiguous", [False, True])
def test_rotations_from_scaled_axes_are_right_handed_and_orthonormal(ambiguous):
    R = orthonormal(normal(30, 3, 4), ambiguous)
    torch.testing.assert_close(R.mT @ R, torch.eye(3, dtype=R.dtype).expand(30, 3, 3))
    torch.testing.assert_close(torch.linalg.det(R), torch.ones(30, dtype=R.dtype))


def test_rotation_vector_agrees_with_scipy():
    rotations = Rotation.random(50, random_state=4)
    found = rotation_vector(torch.tensor(rotations.as_matrix()))
    np.testing.assert_allclose(found, rotations.as_rotvec(), atol=1e-9)


@pytest.mark.parametrize("short_of_half_a_turn", [0.0, 1e-9, 1e-4, 0.1])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_rotation_vector_is_right_up_to_half_a_turn(short_of_half_a_turn, dtype):
    axes = np.concatenate([np.eye(3), normal(20, 3)])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    angle = np.pi - short_of_half_a_turn
    R = torch.tensor(Rotation.from_rotvec(angle * axes).as_matrix()).to(dtype)
    found = rotation_vector(R).double().numpy()
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), angle, atol=1e-5)
    np.testing.assert_allclose(np.abs((found * axes).sum(axis=1)), angle, atol=1e-5)


def test_rotation_vector_of_tiny_turns_is_exact():
    omega = 1e-7 * normal(20, 3)
    R = torch.tensor(Rotation.from_rotvec(omega).as_matrix())
    np.testing.assert_allclose(rotation_vector(R), omega, rtol=1e-6, atol=1e-15)
    assert (rotation_vector(torch.eye(3)[None]) == 0).all()


def test_occupancy_loss_is_the_cross_entropy():
    logits, occupied = normal(2, 7), normal(2, 7, seed=1) > 0
    p = torch.sigmoid(logits)
    expected = -torch.where(occupied, p, 1 - p).log().mean()
    torch.testing.assert_close(occupancy_loss(logits, occupied), expected)


def test_shape_contrast_is_the_mean_log_share_of_the_positives():
    s, temperature = descriptors(), 0.3
    terms = []
    for i in range(len(s)):
        others = [j for j in range(len(s)) if j != i]
        total = sum(np.exp(float(s[i] @ s[j]) / temperature) for j in others)
        terms += [
            -np.log(np.exp(float(s[i] @ s[j]) / temperature) / total)
            for j in others
            if SHAPES[i] == SHAPES[j]
        ]
    assert float(shape_contrast_loss(s, SHAPES, temperature)) == pytest.approx(np.mean(terms))


def test_separated_descriptors_cost_less_than_mixed_ones():
    separated, mixed = torch.eye(8)[SHAPES], torch.eye(8)[[0, 1, 1, 2, 2, 0]]
    losses = [shape_contrast_loss(s, SHAPES) for s in (separated, descriptors().float(), mixed)]
    assert losses[0] < losses[1] < losses[2]


@pytest.mark.parametrize(("ambiguous", "used"), [(False, [0, 1, 2, 3, 4, 5, 6]), (True, [0, 1, 3, 4, 5, 6])])
def test_sigma_loss_is_the_likelihood_of_student_t(ambiguous, used):
    log_sigmas, errors = normal(5, 7), normal(5, 7, seed=1)
    top, bottom = errors[:, 5], errors[:, 6]
    shift = torch.cat([errors[:, 3:5], (top + bottom)[:, None] / 2], -1)
    error = FrameError(errors[:, :3], shift, (top - bottom) / 2)
    oracle = -stats.t(df=4, scale=log_sigmas.exp()).logpdf(errors)[:, used].mean()
    constant = stats.t(df=4).logpdf(0.0)  # which the loss leaves out
    assert float(sigma_loss(log_sigmas, error, ambiguous)) == pytest.approx(oracle + constant)


def test_sigma_loss_does_not_train_the_frames():
    errors = normal(2, 3).requires_grad_()
    log_sigmas = normal(2, 7).requires_grad_()
    sigma_loss(log_sigmas, FrameError(errors, errors, errors[:, 0]), False).backward()
    assert errors.grad is None
    assert log_sigmas.grad is not None


def turned(target, turn):
    """The same boxes with other names for their axes."""
    return torch.cat([target[..., :1], target[..., 1:] @ torch.tensor(turn)], -1)


@pytest.mark.parametrize("turn", BOX.turns)
def test_frames_that_differ_by_a_turn_of_the_symmetry_alone_are_right(turn):
    target = frames(Rotation.random(6, random_state=6).as_matrix(), np.ones((6, 3)))
    predicted = turned(target, turn)
    nearest = nearest_equivalent(predicted, target, BOX)
    torch.testing.assert_close(nearest, predicted)
    assert torch.equal(nearest_equivalent(predicted, target, NONE), target)


def test_nearest_equivalent_has_the_least_frame_loss_of_all():
    target, predicted = (
        frames(Rotation.random(6, random_state=7).as_matrix(), np.zeros((6, 3))),
        normal(6, 3, 4),
    )
    nearest = nearest_equivalent(predicted, target, BOX)
    for i in range(6):
        losses = [
            float(frame_loss(predicted[i : i + 1], turned(target, turn)[i : i + 1])) for turn in BOX.turns
        ]
        assert float(frame_loss(predicted[i : i + 1], nearest[i : i + 1])) == pytest.approx(min(losses))


def test_shipped_losses_train_what_they_should():
    target = frames(Rotation.random(6, random_state=5).as_matrix(), np.zeros((6, 3)))
    nothing = torch.empty(0)
    batch = Batch(nothing, target, SHAPES, nothing, nothing, nothing, nothing)
    parts = [normal(6, 3, 8), normal(6, 3, 4), normal(6, 8), normal(6, 7)]
    encoding = Encoding(*(part.requires_grad_() for part in parts))
    losses = shipped_losses(encoding, batch, NONE)
    assert losses.keys() == {"frame", "shape", "sigma"}
    losses["sigma"].backward()
    assert encoding.frame.grad is None
    assert encoding.log_sigmas.grad is not None
