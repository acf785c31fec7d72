from dataclasses import replace

import numpy as np
import pytest

from neuse.records import Instance, Intrinsics, RgbdFrame
from neuse_bags.scale import ScaleCheck, apparent_size_m

CAMERA = Intrinsics(64, 48, 50.0, 50.0, 31.5, 23.5)


def square(depth_m: float) -> RgbdFrame:
    """An object of 5 by 5 pixels, of which one row has no reading."""
    depth, mask = np.full((48, 64), depth_m, np.float32), np.zeros((48, 64), np.int32)
    mask[10:15, 20:25] = 3
    depth[10, 20:25] = np.nan
    return RgbdFrame(1, depth, mask, (Instance(3, "mug"),), CAMERA)


def test_object_looks_as_large_as_its_pixels_are_at_its_depth() -> None:
    assert apparent_size_m(square(1.2), 3) == pytest.approx(5 / 50 * 1.2)
    assert apparent_size_m(square(0.0), 3) is None
    assert apparent_size_m(square(1.2), 4) is None


@pytest.mark.parametrize("unit", [0.001, 0.2, 100.0, 1000.0])
def test_objects_like_grains_or_houses_betray_a_wrong_unit(unit: float) -> None:
    check = ScaleCheck()
    check.add(square(0.8 * unit))
    assert "the unit of depth is wrong: objects come out" in str(check.fault())


def test_usual_objects_and_frames_without_any_are_no_fault() -> None:
    check = ScaleCheck()
    check.add(replace(square(1e6), instances=()))
    assert check.fault() is None
    for depth_m in (0.5, 0.8, 1000.0):  # most are right
        check.add(square(depth_m))
    assert check.fault() is None


@pytest.mark.parametrize(("factor", "remedy"), [(5.0, 0.2), (10.0, 0.1), (0.2, 5.0), (0.1, 10.0)])
def test_factor_between_usual_units_is_seen_and_its_remedy_told(factor: float, remedy: float) -> None:
    check = ScaleCheck()
    for depth_m in (0.7, 0.8, 0.9):
        check.add(square(depth_m * factor))
    fault = check.fault()
    assert fault is not None
    assert fault.factor == remedy


def test_unknown_categories_may_be_larger() -> None:
    check = ScaleCheck()
    check.add(replace(square(8.0), instances=(Instance(3, "chair"),)))
    assert check.fault() is None


def test_objects_that_the_border_cuts_off_tell_nothing() -> None:
    check, frame = ScaleCheck(), square(0.8)
    frame.mask[:] = 0
    frame.mask[20, 0] = 3
    check.add(frame)
    assert check.fault() is None
