"""Registration of codes: exactness, agreement with scipy, truthful covariances, refusal of bad input."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from neuse.errors import DegenerateGeometryError, InputError
from neuse.geometry import exp, inverse, log, transform_points
from neuse.slam.object_frames import SigmaParams, reduce_codes
from neuse.slam.registration import _horn, align, align_each, align_frames, homogeneous

from .synthetic import make_code, make_thing

MUG_SIGMAS = np.array([0.03, 0.02, 0.1, 0.003, 0.004, 0.005])
BOTTLE_SIGMAS = np.array([0.03, 0.03, np.pi, 0.003, 0.003, 0.005])
HIDDEN_SIGMAS = np.array([0.03, 0.02, 2.0, 0.003, 0.004, 0.005])
AS_PREDICTED = SigmaParams(scale=1.0, rotation_floor_rad=0.0, translation_floor_m=0.0)


def things(rng, kinds):
    """Objects in front of camera a; kinds: m(ug) or b(ottle)."""
    return [
        make_thing(i, kind == "b", rng.uniform([-0.3, -0.3, 1.0], [0.3, 0.3, 1.6]), rng)
        for i, kind in enumerate(kinds)
    ]


def codes_of(objects, T_frame_a=None, rng=None, sigmas=None):
    """Codes in the frame T_frame_a, with noise of the predicted sigmas if a generator is given."""
    T_frame_a = np.eye(4) if T_frame_a is None else T_frame_a
    codes = []
    for thing in objects:
        own = sigmas if sigmas is not None else BOTTLE_SIGMAS if thing.ambiguous else MUG_SIGMAS
        xi = np.zeros(6) if rng is None else own * rng.normal(size=6)
        xi[2] *= not thing.ambiguous
        codes.append(make_code(thing, T_frame_a @ thing.T_world_object @ exp(xi), own))
    return codes


def random_motion(rng):
    return exp(rng.normal(size=6) * [0.5, 0.5, 0.5, 1, 1, 1])


@pytest.mark.parametrize("kinds", ["m", "mb", "bb", "mmbbb"])
def test_exact_codes_give_the_exact_transform(kinds):
    rng = np.random.default_rng(1)
    objects, T_b_a = things(rng, kinds), random_motion(rng)
    alignment = align(codes_of(objects), codes_of(objects, T_b_a))
    np.testing.assert_allclose(alignment.T_b_a, T_b_a, atol=1e-9)
    assert alignment.residual_m < 1e-9
    assert alignment.inliers.all()
    assert alignment.n_objects == len(kinds)


def test_swapping_the_views_inverts_the_transform():
    rng = np.random.default_rng(2)
    objects, T_b_a = things(rng, "mbb"), random_motion(rng)
    codes_a, codes_b = codes_of(objects, rng=rng), codes_of(objects, T_b_a, rng)
    forward, backward = align(codes_a, codes_b), align(codes_b, codes_a)
    np.testing.assert_allclose(forward.T_b_a @ backward.T_b_a, np.eye(4), atol=2e-3)


def test_horn_agrees_with_scipy():
    rng = np.random.default_rng(3)
    objects, T_b_a = things(rng, "mbmb"), random_motion(rng)
    a = reduce_codes(codes_of(objects, rng=rng))
    b = reduce_codes(codes_of(objects, T_b_a, rng))
    weights = rng.uniform(0.5, 2.0, size=(3, 4))
    T = _horn(homogeneous(a.vectors), homogeneous(b.vectors)[None], weights[None])[0]
    share = (weights[0] / weights[0].sum())[:, None]
    mean_a, mean_b = (share * a.centers).sum(axis=0), (share * b.centers).sum(axis=0)
    vectors_a = np.concatenate([a.centers - mean_a, *a.vectors[1:]])
    vectors_b = np.concatenate([b.centers - mean_b, *b.vectors[1:]])
    expected, _ = Rotation.align_vectors(vectors_b, vectors_a, weights.ravel())
    np.testing.assert_allclose(T[:3, :3], expected.as_matrix(), atol=1e-9)
    np.testing.assert_allclose(T[:3, 3], mean_b - expected.apply(mean_a), atol=1e-9)


@pytest.mark.parametrize("kinds", ["m", "mb", "bb", "mmbb"])
def test_covariance_predicts_the_error(kinds):
    rng = np.random.default_rng(4)
    nees = []
    for _ in range(100):
        objects, T_b_a = things(rng, kinds), random_motion(rng)
        alignment = align(codes_of(objects, rng=rng), codes_of(objects, T_b_a, rng), AS_PREDICTED)
        error = log(inverse(alignment.T_b_a) @ T_b_a)
        nees.append(error @ np.linalg.solve(alignment.covariance, error))
    assert 4.8 < np.mean(nees) < 7.5


def with_ends(codes, top_m, bottom_m, rng):
    """Codes whose ends err on their own, with standard deviations (n,) of tops and of bottoms, and say so."""
    made = []
    for code, *sigmas in zip(codes, top_m, bottom_m, strict=True):
        top, bottom = sigmas * rng.normal(size=2)
        square = np.square(sigmas)
        axis = code.T_frame_object[:3, 2]
        along = (code.z - code.center) @ axis
        z = code.z + ((top + bottom) / 2 + along * (top - bottom) / 2 / code.half_height)[:, None] * axis
        own = np.array([*code.sigmas[:5], np.sqrt(square.sum()) / 2])
        correlation = float((square[0] - square[1]) / square.sum())
        made.append(replace(code, z=z, sigmas=own, height_correlation=correlation))
    return made


def test_covariance_predicts_the_error_where_ends_are_hidden():
    rng = np.random.default_rng(12)
    nees, shifts_m, blind_m = [], [], []
    still = np.array([1, 1, 1, 1, 1, 0])  # along the axis the ends err
    for _ in range(150):
        objects, T_b_a = things(rng, "mbb"), random_motion(rng)
        a, b = (
            with_ends(
                codes_of(objects, T, rng, still * MUG_SIGMAS),
                *rng.choice([0.002, 0.03], size=(2, 3)),
                rng,
            )
            for T in (None, T_b_a)
        )
        alignment = align(a, b, AS_PREDICTED)
        error = log(inverse(alignment.T_b_a) @ T_b_a)
        nees.append(error @ np.linalg.solve(alignment.covariance, error))
        unaware = [[replace(code, height_correlation=0.0) for code in codes] for codes in (a, b)]
        blind = align(*unaware, AS_PREDICTED)
        middle = np.append(np.mean([thing.T_world_object[:3, 3] for thing in objects], axis=0), 1.0)
        shifts_m.append(np.linalg.norm((alignment.T_b_a - T_b_a) @ middle))
        blind_m.append(np.linalg.norm((blind.T_b_a - T_b_a) @ middle))
    assert 4.5 < np.median(nees) < 7.0
    assert np.median(shifts_m) < 0.85 * np.median(blind_m)


def test_an_end_that_both_views_see_tells_where_a_bottle_is():
    rng = np.random.default_rng(13)
    objects, T_b_a = things(rng, "bb"), random_motion(rng)
    whole = codes_of(objects, sigmas=0.1 * BOTTLE_SIGMAS)
    cut = with_ends(codes_of(objects, T_b_a), [0.0, 0.0], [0.05, 0.05], rng)  # bottoms hidden
    centers = transform_points(T_b_a, np.stack([code.center for code in whole]))
    assert np.linalg.norm(centers - [code.center for code in cut], axis=1).max() > 0.01
    found = transform_points(align(whole, cut).T_b_a, np.stack([code.center for code in whole]))
    assert np.linalg.norm(centers - found, axis=1).max() < 0.001


def test_larger_sigmas_give_a_larger_covariance():
    rng = np.random.default_rng(5)
    objects = things(rng, "mb")
    codes = codes_of(objects)
    trusted, doubted = (align(codes, codes, replace(AS_PREDICTED, scale=scale)) for scale in (1.0, 2.0))
    np.testing.assert_allclose(doubted.covariance, 4 * trusted.covariance, rtol=1e-6, atol=1e-12)
    assert doubted.sigma_rotation_rad == pytest.approx(2 * trusted.sigma_rotation_rad)
    assert doubted.sigma_translation_m == pytest.approx(2 * trusted.sigma_translation_m)


def test_object_that_moved_is_no_inlier_and_does_not_pull():
    rng = np.random.default_rng(6)
    objects, T_b_a = things(rng, "mbmb"), random_motion(rng)
    moved = replace(objects[1], T_world_object=exp([0, 0, 0, 0.15, 0.1, 0]) @ objects[1].T_world_object)
    alignment = align(codes_of(objects), codes_of([objects[0], moved, *objects[2:]], T_b_a))
    assert alignment.inliers.tolist() == [True, False, True, True]
    assert np.linalg.norm(log(inverse(alignment.T_b_a) @ T_b_a)[3:]) < 0.005


def test_flipped_handle_among_others_does_not_turn_the_pose():
    rng = np.random.default_rng(7)
    objects, T_b_a = things(rng, "mbb"), random_motion(rng)
    flipped = replace(objects[0], T_world_object=objects[0].T_world_object @ exp([0, 0, np.pi, 0, 0, 0]))
    alignment = align(codes_of(objects), codes_of([flipped, *objects[1:]], T_b_a))
    assert np.abs(log(inverse(alignment.T_b_a) @ T_b_a)[:3]).max() < 0.02


def test_aligning_each_equals_aligning_one_by_one():
    rng = np.random.default_rng(8)
    objects = things(rng, "mbmb")
    a = reduce_codes(codes_of(objects, rng=rng))
    others = []
    for index in ([0, 1, 2, 3], [2, 0], [1]):
        T_b_a = random_motion(rng)
        others.append((np.array(index), reduce_codes(codes_of([objects[i] for i in index], T_b_a, rng))))
    together = align_each(a, others)
    assert together[2] is None  # a lone bottle
    for (index, b), alignment in zip(others[:2], together, strict=False):
        alone = align_frames(a[index], b)
        np.testing.assert_allclose(alignment.T_b_a, alone.T_b_a, atol=1e-10)
        np.testing.assert_allclose(alignment.covariance, alone.covariance, atol=1e-12)
        assert alignment.residual_m == pytest.approx(alone.residual_m)


def test_aligning_with_no_other_view_gives_nothing():
    assert align_each(reduce_codes([]), []) == []


@pytest.mark.parametrize(("kinds", "sigmas"), [("b", BOTTLE_SIGMAS), ("m", HIDDEN_SIGMAS), ("", None)])
def test_views_that_leave_a_rotation_free_are_refused(kinds, sigmas):
    codes = codes_of(things(np.random.default_rng(9), kinds), sigmas=sigmas)
    with pytest.raises(DegenerateGeometryError):
        align(codes, codes)


def test_two_bottles_on_one_axis_are_refused():
    rng = np.random.default_rng(10)
    bottle = make_thing(0, True, np.array([0.0, 0.0, 1.0]), rng)
    above = replace(bottle, T_world_object=bottle.T_world_object @ exp([0, 0, 0, 0, 0, 0.4]))
    with pytest.raises(DegenerateGeometryError):
        align(codes_of([bottle, above]), codes_of([bottle, above]))


def test_unequal_numbers_are_refused():
    codes = codes_of(things(np.random.default_rng(11), "mm"))
    with pytest.raises(InputError, match="pair them") as error:
        align(codes, codes[:1])
    assert error.value.reason == "unequal_lengths"


def test_mixed_categories_are_refused():
    codes = codes_of(things(np.random.default_rng(12), "mb"))
    with pytest.raises(InputError, match="pair 0 joins a mug with a bottle"):
        align(codes, codes[::-1])


def test_codes_that_are_not_finite_are_refused():
    codes = codes_of(things(np.random.default_rng(13), "mb"))
    broken = replace(codes[0], z=np.full_like(codes[0].z, np.nan))
    with pytest.raises(InputError) as error:
        align(codes, [broken, codes[1]])
    assert error.value.reason == "code_not_finite"
