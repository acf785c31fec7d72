"""What the shipped weights promise, on rendered views of unseen shapes; bounds far above their figures."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

import neuse
from neuse.embedding.embedding import WEIGHTS
from neuse.embedding.layouts import draw_layout
from neuse.embedding.network import read_card
from neuse.embedding.views import POINT_UNIT_M, ViewParams, draw_view
from neuse.geometry import inverse, transform_points
from neuse.simulation.shapes import sample_shape, symmetry_of

from .tiny import random_transform

CATEGORIES = ("bottle", "bowl", "box", "mug")
PARAMS = ViewParams(range_m=(0.5, 1.2), clutter=(1, 1), fixed_noise_m=0.0015, mask_faults=False)
N_SHAPES, N_VIEWS = 4, 4


@pytest.fixture(scope="module", params=CATEGORIES)
def embedding(request):
    """A shipped embedding; fails where its weights are missing."""
    return neuse.load_embedding(request.param)


@pytest.fixture(scope="module")
def views(embedding):
    """[(shape, T_camera_object, cloud)] of well visible objects of the test split."""
    rng = np.random.default_rng([9, *embedding.category.encode()])
    shapes = [sample_shape(embedding.category, rng, "test") for _ in range(N_SHAPES)]
    found = []
    for shape in shapes:
        layout = draw_layout(shape, [shape], rng, PARAMS.clutter)
        drawn = [view for _ in range(3 * N_VIEWS) if (view := draw_view(layout, rng, PARAMS)) is not None]
        for view in [view for view in drawn if view["visible"] > 0.7][:N_VIEWS]:
            cloud = view["points"][: int(view["n_points"])] * POINT_UNIT_M + view["partial_center"]
            found.append((shape, view["T_camera_object"].astype(float), cloud))
    return found


@pytest.fixture(scope="module")
def codes(embedding, views):
    return embedding.encode([cloud for _, _, cloud in views])


def axis_error_deg(code, T_camera_object):
    """Of the axis, or of the edge of a box that the code took for it."""
    turns = symmetry_of(code.category).turns
    cosines = (T_camera_object[:3, :3] @ turns)[:, :, 2] @ code.T_frame_object[:3, 2]
    return np.degrees(np.arccos(min(cosines.max(), 1.0)))


def test_shipped_network_is_equivariant(embedding, views):
    rng = np.random.default_rng(0)
    clouds = [cloud for _, _, cloud in views[:5]]
    T = random_transform(rng)
    codes = embedding.encode(clouds)
    for code, moved in zip(codes, embedding.encode([transform_points(T, c) for c in clouds]), strict=True):
        spread = np.linalg.norm(code.z - code.center)
        assert np.linalg.norm(moved.z - code.transformed(T).z) <= 1e-4 * spread
        np.testing.assert_allclose(moved.descriptor, code.descriptor, atol=1e-4)
        np.testing.assert_allclose(moved.sigmas, code.sigmas, rtol=1e-3)


def test_centres_and_axes_are_found(codes, views):
    shift_mm = [1e3 * np.linalg.norm(c.center - T[:3, 3]) for c, (_, T, _) in zip(codes, views, strict=True)]
    tilt_deg = [axis_error_deg(c, T) for c, (_, T, _) in zip(codes, views, strict=True)]
    assert len(views) >= N_SHAPES
    assert np.median(shift_mm) < 10.0
    assert np.median(tilt_deg) < 6.0


def test_stated_sigmas_are_of_the_size_of_the_errors(codes, views):
    ratios = []
    for code, (_, T_camera_object, _) in zip(codes, views, strict=True):
        T_error = inverse(code.T_frame_object) @ T_camera_object
        ratios += list(np.abs(T_error[:3, 3]) / code.sigmas[3:])
    assert 0.1 < np.median(ratios) < 3.0  # 0.67 for a normal distribution


def test_descriptors_tell_one_shape_from_another(codes, views):
    descriptors = np.stack([code.descriptor for code in codes])
    similarity = descriptors @ descriptors.T
    names = np.array([shape.name for shape, _, _ in views])
    same, other = names[:, None] == names, ~np.eye(len(names), dtype=bool)
    assert similarity[same & other].mean() > similarity[~same].mean() + 0.05


def test_reconstruction_is_a_closed_mesh_of_the_size_of_the_object(embedding, codes, views):
    errors_m = []
    for code, (shape, T_camera_object, _) in list(zip(codes, views, strict=True))[::N_VIEWS]:
        mesh = embedding.reconstruct(code, 0.004)
        assert mesh.is_watertight
        assert mesh.volume > 0
        points, _ = trimesh.sample.sample_surface(mesh, 300, seed=0)
        points_object = transform_points(inverse(T_camera_object), points)
        true_points, _ = trimesh.sample.sample_surface(shape.mesh, 3000, seed=0)
        errors_m.append(cKDTree(true_points).query(points_object)[0].mean())
    assert np.median(errors_m) < 0.012


@pytest.mark.parametrize("category", CATEGORIES)
def test_weights_carry_their_card(category):
    card = read_card(WEIGHTS / f"{category}.safetensors")
    assert card["category"] == category
    assert {"recipe", "params", "hours", "commit", "validation"} <= card.keys()
    assert "seed" in card["params"]
