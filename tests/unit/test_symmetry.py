"""Symmetries are groups of rotations."""

import numpy as np
import pytest

from neuse.errors import InputError
from neuse.symmetry import SYMMETRIES, Symmetry, symmetry_named

ALL = pytest.mark.parametrize("symmetry", SYMMETRIES.values(), ids=lambda symmetry: symmetry.name)


def is_one_of(turn: np.ndarray, turns: np.ndarray) -> bool:
    return bool(np.isclose(turns, turn).all(axis=(1, 2)).any())


@ALL
def test_turns_are_right_handed_rotations_without_repetition(symmetry: Symmetry) -> None:
    turns = symmetry.turns
    np.testing.assert_allclose(
        turns @ turns.transpose(0, 2, 1), np.tile(np.eye(3), (len(turns), 1, 1)), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(turns), 1.0)
    assert len(np.unique(turns.round(6).reshape(len(turns), 9), axis=0)) == len(turns)


@ALL
def test_turns_are_a_group(symmetry: Symmetry) -> None:
    assert is_one_of(np.eye(3), symmetry.turns)
    assert all(is_one_of(a @ b, symmetry.turns) for a in symmetry.turns for b in symmetry.turns)


def test_groups_have_their_sizes() -> None:
    sizes = {name: len(symmetry.turns) for name, symmetry in SYMMETRIES.items()}
    assert sizes == {"none": 1, "axial": 1, "half-turn": 2, "quarter-turn": 4, "box": 24}


@ALL
def test_a_rotation_is_told_only_where_no_turn_or_choice_of_frame_changes_it(symmetry: Symmetry) -> None:
    axis_stays = np.allclose(symmetry.turns[:, :, 2], [0, 0, 1])
    assert (0 in symmetry.untold) == (1 in symmetry.untold) == (not axis_stays)
    assert (2 in symmetry.untold) == (symmetry.ambiguous or len(symmetry.turns) > 1)


def test_symmetry_is_found_by_its_name() -> None:
    assert symmetry_named("box") is SYMMETRIES["box"]


def test_unknown_symmetry_is_refused() -> None:
    with pytest.raises(InputError, match="'round'; choose one of none, axial"):
        symmetry_named("round")
