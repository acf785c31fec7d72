import numpy as np
import pytest

from neuse.errors import ParamError
from neuse.simulation.sensor import (
    SensorFaults,
    apply_faults,
    faulty_depth,
    faulty_mask,
    ideal,
    nominal,
    real,
)

NEAR_M, FAR_M = 1.0, 2.0


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def step_image(height=100, width=160):
    """A near square in front of a far wall."""
    depth_m = np.full((height, width), FAR_M, dtype=np.float32)
    depth_m[30:70, 60:100] = NEAR_M
    return depth_m


def two_instances():
    label = np.zeros((60, 80), dtype=np.int32)
    label[10:40, 10:30] = 4
    label[10:50, 31:60] = 9
    return label


def test_ideal_sensor_changes_nothing(rng):
    depth_m, label = step_image(), two_instances()
    seen_m, mask = apply_faults(depth_m, label, ideal(), rng)
    np.testing.assert_array_equal(seen_m, depth_m)
    np.testing.assert_array_equal(mask, label)
    assert seen_m is not depth_m


@pytest.mark.parametrize("grain_px", [1, 3])
@pytest.mark.parametrize("range_m", [0.5, 1.0, 3.0])
def test_noise_grows_with_range_squared(rng, grain_px, range_m):
    depth_m = np.full((300, 300), range_m, dtype=np.float32)
    seen_m = faulty_depth(depth_m, SensorFaults(noise_m_at_1m=0.002, noise_grain_px=grain_px), rng)
    assert seen_m.std() == pytest.approx(0.002 * range_m**2, rel=0.05)
    assert seen_m.mean() == pytest.approx(range_m, abs=0.001 * range_m**2)


def test_grain_makes_neighbouring_noise_alike(rng):
    depth_m = np.ones((200, 200), dtype=np.float32)
    error = faulty_depth(depth_m, SensorFaults(noise_m_at_1m=0.002, noise_grain_px=3), rng) - 1.0
    assert np.corrcoef(error[:, :-1].ravel(), error[:, 1:].ravel())[0, 1] == pytest.approx(2 / 3, abs=0.05)
    assert np.corrcoef(error[:, :-3].ravel(), error[:, 3:].ravel())[0, 1] == pytest.approx(0.0, abs=0.05)


def test_quantisation_gives_whole_steps(rng):
    seen_mm = faulty_depth(np.linspace(0.5, 3.0, 1000, dtype=np.float32)[None], nominal(), rng) * 1000
    assert seen_mm == pytest.approx(np.round(seen_mm), abs=1e-3)


def test_no_reading_stays_no_reading(rng):
    depth_m = step_image()
    depth_m[:10] = 0.0
    for faults in (nominal(), real()):
        assert not faulty_depth(depth_m, faults, rng)[:10].any()


def test_nothing_is_read_beyond_the_range(rng):
    seen_m = faulty_depth(step_image(), SensorFaults(max_range_m=1.5), rng)
    assert set(np.unique(seen_m)) == {0.0, NEAR_M}


def test_stereo_shadow_lies_left_of_the_near_surface_and_is_as_wide_as_the_disparity_jump(rng):
    baseline_px_m = 20.0
    seen_m = faulty_depth(step_image(), SensorFaults(baseline_px_m=baseline_px_m), rng)
    hidden = seen_m[50] == 0.0
    width_px = baseline_px_m / NEAR_M - baseline_px_m / FAR_M
    np.testing.assert_array_equal(np.flatnonzero(hidden), np.arange(60 - width_px + 1, 60))
    assert (seen_m[10] == FAR_M).all()


def test_flying_pixels_lie_between_the_surfaces_and_at_their_edges(rng):
    depth_m = step_image()
    seen_m = faulty_depth(depth_m, SensorFaults(flying_rate=0.5), rng)
    rows, columns = np.nonzero(seen_m != depth_m)
    assert len(rows) > 40
    assert np.all((seen_m[rows, columns] >= NEAR_M) & (seen_m[rows, columns] <= FAR_M))
    to_edge = np.maximum(np.abs(rows - 49.5), np.abs(columns - 79.5))
    assert np.all(np.abs(to_edge - 20.0) <= 0.5)


def test_holes_at_edges_are_only_at_edges(rng):
    depth_m = step_image()
    rows, columns = np.nonzero(faulty_depth(depth_m, SensorFaults(edge_hole_rate=0.5), rng) == 0.0)
    assert len(rows) > 40
    assert np.all(np.abs(np.maximum(np.abs(rows - 49.5), np.abs(columns - 79.5)) - 20.0) <= 0.5)


def test_hole_patches_have_the_rate_and_size_asked_for(rng):
    faults = SensorFaults(hole_rate=2.0, hole_radius_px=3.0)
    missing = faulty_depth(np.ones((1000, 1000), dtype=np.float32), faults, rng) == 0.0
    mean_area_px = np.pi * 2.0**2  # radii are uniform in 1 to 3 px
    assert missing.sum() == pytest.approx(2.0 * 100 * mean_area_px, rel=0.2)


def test_masks_erode_and_grow_within_their_bounds(rng):
    label = two_instances()
    sizes = []
    for _ in range(40):
        mask = faulty_mask(label, SensorFaults(erosion_px=2, dilation_px=1), rng)
        rows, columns = np.nonzero(mask == 4)
        sizes.append((rows.min(), rows.max(), columns.min()))
    assert {int(low) for low, _, _ in sizes} == {9, 10, 11, 12}
    assert {int(high) for _, high, _ in sizes} == {37, 38, 39, 40}
    assert {int(left) for _, _, left in sizes} == {9, 10, 11, 12}


def test_growing_mask_takes_no_pixel_of_a_neighbour(rng):
    label = two_instances()
    for _ in range(20):
        mask = faulty_mask(label, SensorFaults(dilation_px=3), rng)
        assert np.all(mask[label == 4] == 4)
        assert np.all(mask[label == 9] == 9)


def test_cut_mask_loses_one_side(rng):
    label = two_instances()
    mask = faulty_mask(label, SensorFaults(cut_rate=1.0, cut_share=0.5), rng)
    for instance in (4, 9):
        own, kept = label == instance, mask == instance
        assert 0 < kept.sum() < own.sum()
        lost_center, kept_center = (np.argwhere(part).mean(axis=0) for part in (own & ~kept, kept))
        direction = lost_center - kept_center
        assert (np.argwhere(own & ~kept) @ direction).min() > (np.argwhere(kept) @ direction).mean()


def test_touching_masks_merge_under_the_label_of_the_larger(rng):
    mask = faulty_mask(two_instances(), SensorFaults(merge_rate=1.0), rng)
    assert set(np.unique(mask)) == {0, 9}
    assert (mask == 9).sum() == (two_instances() > 0).sum()


def test_distant_masks_do_not_merge(rng):
    label = two_instances()
    label[:, 30:35] = 0
    np.testing.assert_array_equal(faulty_mask(label, SensorFaults(merge_rate=1.0), rng), label)


def test_missed_masks_are_gone_at_the_rate_asked_for(rng):
    label = np.arange(1, 2001, dtype=np.int32).reshape(40, 50).repeat(2, axis=0).repeat(2, axis=1)
    mask = faulty_mask(label, SensorFaults(miss_rate=0.25), rng)
    assert len(np.unique(mask[mask > 0])) == pytest.approx(1500, abs=60)
    assert np.all((mask == label) | (mask == 0))


def test_specks_of_masks_are_gone(rng):
    label = two_instances()
    label[55, 70:75] = 2
    assert set(np.unique(faulty_mask(label, SensorFaults(min_mask_px=6), rng))) == {0, 4, 9}


def test_real_sensor_has_every_fault_and_repeats_with_its_seed():
    depth_m, label = step_image(), two_instances()
    first = [apply_faults(depth_m[:60, :80], label, real(), np.random.default_rng(5)) for _ in range(2)]
    np.testing.assert_array_equal(first[0][0], first[1][0])
    np.testing.assert_array_equal(first[0][1], first[1][1])
    off = SensorFaults()
    assert all(
        getattr(real(), name) != getattr(off, name)
        for name in vars(off)
        if name not in ("hole_radius_px", "edge_jump", "cut_share")
    )


def test_rate_above_one_is_refused():
    with pytest.raises(ParamError, match="miss_rate"):
        SensorFaults(miss_rate=1.5)
