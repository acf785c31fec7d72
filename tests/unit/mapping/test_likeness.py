from dataclasses import replace

import numpy as np
import pytest

from neuse.mapping.likeness import likeness

from .synthetic import make_code, standing

CLEAR, POOR = 0.002, 0.03  # sigma of the centre, metres


def code_like(cosine: float, sigma_m: float = CLEAR, category: str = "mug"):
    """A code whose descriptor has this cosine to that of `code_like(1.0)`."""
    thing = standing("thing", 0.0, 0.0, category=category)
    code = make_code(thing, thing.T_world_object, np.random.default_rng(0), 0.0)
    descriptor = np.zeros_like(code.descriptor)
    descriptor[:2] = cosine, np.sqrt(1.0 - cosine**2)
    return replace(code, descriptor=descriptor, sigmas=np.array([0.1, 0.1, 0.1, *[sigma_m] * 3]))


def test_what_poor_views_show_of_an_object_does_not_make_it_another():
    for sigma_m, is_one in ((CLEAR, False), (POOR, True)):
        assert (likeness(code_like(1.0), code_like(0.87, sigma_m)) > 0.0) == is_one


def test_well_seen_objects_are_told_apart_where_their_descriptors_hardly_differ():
    assert likeness(code_like(1.0), code_like(0.98)) > 3.0
    assert likeness(code_like(1.0), code_like(0.7)) < -3.0


@pytest.mark.parametrize("sigma_m", [CLEAR, POOR])
def test_likeness_falls_with_the_cosine_and_is_symmetric(sigma_m):
    found = [likeness(code_like(1.0), code_like(c, sigma_m)) for c in (1.0, 0.99, 0.9, 0.5, -1.0)]
    assert found == sorted(found, reverse=True)
    assert np.isfinite(found).all()
    assert likeness(code_like(0.9, sigma_m), code_like(1.0)) == pytest.approx(found[2])


def test_objects_of_different_categories_or_networks_are_never_one():
    mug = code_like(1.0)
    assert likeness(mug, code_like(1.0, category="bottle")) == -np.inf
    assert likeness(mug, replace(mug, descriptor=np.ones(3) / np.sqrt(3.0))) == -np.inf
