"""Frames of boxes whose codes decode to the very same boxes, or to others."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from evaluation.conftest import EXTENTS
from neuse.embedding.code import Code
from neuse.errors import InputError
from neuse.evaluation.reconstruction_plots import reconstruction_figure
from neuse.evaluation.reconstructions import (
    reconstruct_frame,
    reconstructions_dict,
    surface_distance,
    telling_frames,
)
from neuse.geometry import exp
from neuse.records import Intrinsics, Observation, ObservedFrame, RgbdFrame
from neuse.simulation.camera import DepthCamera, RayScene, Solid

CAMERA = Intrinsics(160, 120, 150.0, 150.0, 79.5, 59.5)
POSES = {3: exp([0.3, 0.2, 0.1, -0.1, 0.0, 0.8]), 7: exp([0.1, -0.4, 0.6, 0.12, 0.03, 0.9])}


def _fine_box(code: Code, margin_m: float = 0.0) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(2 * (EXTENTS + margin_m), code.T_frame_object)
    return mesh.subdivide_to_size(0.005)


@pytest.fixture
def view(map_object) -> tuple[RgbdFrame, ObservedFrame]:
    """What a perfect camera sees of two boxes, and their true codes."""
    codes = {label: map_object(label, T).code for label, T in POSES.items()}
    solids = [Solid(_fine_box(code), np.eye(4), label) for label, code in codes.items()]
    seen = DepthCamera(CAMERA).render(RayScene(solids), np.eye(4))
    observations = tuple(
        Observation(label, 1.0, code, np.zeros((0, 3)), code.center, int((seen.label == label).sum()))
        for label, code in codes.items()
    )
    frame = RgbdFrame(5, seen.depth_m, seen.label, (), CAMERA)
    return frame, ObservedFrame(5, observations, CAMERA, seen.depth_m[::8, ::8])


def test_every_reading_lies_on_the_true_shape(view) -> None:
    frame, observed = view
    objects = reconstruct_frame(frame, observed, {"mug": _fine_box}).objects
    assert [len(item.points) for item in objects] == [o.mask_px for o in observed.observations]
    assert [item.enclosed_share for item in objects] == [1.0, 1.0]
    assert max(surface_distance(item.mesh, item.points).max() for item in objects) < 0.005


@pytest.mark.parametrize("margin_m", [0.02, -0.02])
def test_reading_further_than_a_centimetre_is_not_enclosed_whichever_side_it_is_on(
    view, margin_m: float
) -> None:
    objects = reconstruct_frame(*view, {"mug": lambda code: _fine_box(code, margin_m)}).objects
    assert max(item.enclosed_share for item in objects) < 0.3


def test_distance_to_the_surface_is_never_too_small_and_at_most_a_cell_too_large() -> None:
    ball = trimesh.creation.icosphere(5, 0.05)
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (500, 3))
    true_m = np.abs(np.linalg.norm(points, axis=1) - 0.05)
    excess_m = surface_distance(ball, points) - true_m
    assert excess_m.min() > -1e-4
    assert excess_m.max() < 0.0025


def _refuse(code: Code) -> trimesh.Trimesh:
    raise InputError("empty_reconstruction", "no shape")


@pytest.mark.parametrize("decoders", [{}, {"mug": _refuse}])
def test_observation_that_cannot_be_decoded_is_left_out(view, decoders) -> None:
    frame = reconstruct_frame(*view, decoders)
    assert frame.objects == ()
    assert reconstructions_dict([frame]) is None


def test_observation_without_any_reading_is_left_out(view) -> None:
    frame, observed = view
    blind = replace(frame, depth_m=np.where(frame.mask == 3, np.nan, frame.depth_m))
    (item,) = reconstruct_frame(blind, observed, {"mug": _fine_box}).objects
    assert item.observation.label == 7


def test_figures_name_each_instance_and_sum_up(view) -> None:
    frame, observed = view

    def decode(code: Code) -> trimesh.Trimesh:
        return _fine_box(code, 0.02 if code.center[0] > 0 else 0.0)

    figures = reconstructions_dict([reconstruct_frame(frame, observed, {"mug": decode})])
    assert figures is not None
    first, second = figures["instances"]
    assert (first["stamp_ns"], first["label"], first["category"]) == (5, 3, "mug")
    assert first["enclosed_share"] == 1.0
    assert first["range_m"] == pytest.approx(np.linalg.norm(POSES[3][:3, 3]))
    shares = [first["enclosed_share"], second["enclosed_share"]]
    assert figures["enclosed_share"] == {"min": min(shares), "mean": pytest.approx(np.mean(shares))}


def test_telling_frames_are_spread_over_the_run_and_show_most(view) -> None:
    _, observed = view
    large, small = observed.observations
    run = [
        replace(observed, stamp_ns=stamp, observations=shown)
        for stamp, shown in enumerate([(small,), (large, small), (), (large,), (), ()])
    ]
    assert [frame.stamp_ns for frame in telling_frames(run, 3)] == [1, 3]
    assert [frame.stamp_ns for frame in telling_frames(run[:1], 3)] == [0]
    assert telling_frames([], 3) == []


@pytest.mark.parametrize("with_color", [True, False])
def test_figure_has_masks_shapes_and_a_close_up_of_every_object(view, with_color: bool) -> None:
    frame, observed = view
    color = np.full((*frame.mask.shape, 3), 90, dtype=np.uint8) if with_color else None
    seen = reconstruct_frame(replace(frame, color=color), observed, {"mug": _fine_box})
    figure = reconstruction_figure([seen, replace(seen, objects=())])
    titles = [axes.get_title() for axes in figure.axes]
    assert titles[2:4] == ["3: mug, 100%", "7: mug, 100%"]
    masks, shapes = (figure.axes[i].images[0].get_array() for i in (0, 1))
    changed = (np.abs(masks.astype(int) - shapes) > 3).any(axis=2)
    # the true shapes cover the masks, and nothing else
    rows, columns = np.nonzero(frame.mask)
    height, width = changed.shape
    assert changed.sum() == pytest.approx(len(rows), rel=0.1)
    assert (height, width) >= (np.ptp(rows), np.ptp(columns))
