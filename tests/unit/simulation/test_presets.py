import numpy as np
import pytest

from neuse.simulation.presets import PRESETS


def n_changes(preset):
    return sum(p.added + p.removed + p.moved + 2 * p.swapped_pairs for p in preset.changes)


@pytest.mark.parametrize(
    ("name", "tables", "objects", "traversals", "changes"),
    [
        ("tabletop", 3, 12, 2, 3),
        ("kitchen", 3, 12, 2, 3),
        ("synthetic-planar", 10, 50, 2, 9),
        ("synthetic-nonplanar", 10, 50, 2, 9),
        ("four-round", 5, 28, 4, 9),
        ("triple-infinity", 5, 28, 3, 7),
    ],
)
def test_presets_have_the_numbers_of_their_experiments(name, tables, objects, traversals, changes):
    preset = PRESETS[name]
    assert preset.name == name
    assert len(preset.tables) == tables
    assert preset.objects == objects
    assert len(preset.routes) == traversals
    assert n_changes(preset) == changes
    assert all(plan.traversal < traversals for plan in preset.changes)


@pytest.mark.parametrize(
    ("name", "area_m"),
    [("synthetic-planar", (10.0, 15.0)), ("four-round", (6.0, 3.0)), ("triple-infinity", (6.0, 3.0))],
)
def test_tables_stand_inside_the_area_of_the_experiment(name, area_m):
    signs = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
    corners = np.concatenate(
        [
            signs * np.array(table.size_m) / 2 @ table.T_world_table[:2, :2].T + table.center
            for table in PRESETS[name].tables
        ]
    )
    assert np.all(np.ptp(corners, axis=0) <= area_m)


def test_synthetic_route_passes_each_table_on_both_sides():
    preset = PRESETS["synthetic-planar"]
    for table in preset.tables:
        sides = []
        for route in preset.routes:
            positions = np.array([waypoint.position[:2] for waypoint in route])
            nearest = positions[np.argmin(np.linalg.norm(positions - table.center, axis=1))]
            sides.append((nearest - table.center) @ table.T_world_table[:2, 1])
        assert sides[0] * sides[1] < 0.0
        assert np.abs(sides) == pytest.approx(0.65, abs=0.02)
