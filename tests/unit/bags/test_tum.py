from pathlib import Path

import numpy as np
import pytest

from bags.layouts import CAMERA, DEPTH_M, STAMPS_S, color, depth, labels, make_tum, write_json, write_picture
from neuse.errors import InputError
from neuse_bags.tum import open_tum


@pytest.fixture
def tum(tmp_path: Path) -> Path:
    return make_tum(tmp_path / "tum")


def test_lists_become_frames_with_the_stamps_of_the_depth_pictures(tum: Path) -> None:
    source = open_tum(tum)
    first, second = source.frames()
    assert (source.n_frames, source.notes) == (2, ())
    assert [first.stamp_ns, second.stamp_ns] == [1305031102175304000, 1305031102275326000]
    np.testing.assert_allclose(first.depth_m[labels() > 0], DEPTH_M, rtol=1e-6)
    np.testing.assert_array_equal(first.mask, labels())
    np.testing.assert_array_equal(first.color, color()[..., ::-1])
    assert [(i.label, i.category) for i in first.instances] == [(1, "mug"), (2, "bottle")]
    assert vars(first.intrinsics) == CAMERA


def test_true_poses_are_read_with_the_stamps_of_their_lines(tum: Path) -> None:
    trajectories = open_tum(tum).trajectories
    ((stamp_ns, T_world_camera),) = trajectories.ground_truth
    assert (stamp_ns, trajectories.odometry) == (1305031102175304000, [])
    np.testing.assert_allclose(T_world_camera[:3, 3], [1, 2, 3])
    np.testing.assert_allclose(T_world_camera[:2, 0], [1 - 2 * 0.36, 2 * 0.48])  # 0.6, 0.8: about z


def test_unit_of_depth_may_be_given(tum: Path) -> None:
    write_json(tum / "camera.json", CAMERA | {"depth_scale": 1.0})
    frame = next(iter(open_tum(tum).frames()))
    np.testing.assert_allclose(frame.depth_m[labels() > 0], 5 * DEPTH_M, rtol=1e-6)


def test_without_colour_masks_have_the_names_of_the_depth_pictures(tum: Path) -> None:
    (tum / "rgb.txt").unlink()
    for stamp in STAMPS_S:
        write_picture(tum / "masks" / f"{stamp}.png", labels())
    frames = list(open_tum(tum).frames())
    assert len(frames) == 2
    assert all(frame.color is None for frame in frames)


def test_labels_may_be_given_for_each_picture(tum: Path) -> None:
    name = next(iter((tum / "masks").glob("*.png"))).stem
    write_json(tum / "masks" / "instances.json", {name: {"2": "kettle"}})
    found = {frame.instances for frame in open_tum(tum).frames()}
    assert sorted(len(instances) for instances in found) == [0, 1]
    assert {i.category for instances in found for i in instances} == {"kettle"}


def test_depth_picture_without_colour_is_left_out_and_told(tum: Path) -> None:
    with (tum / "depth.txt").open("a") as stream:
        stream.write("1305031199.0 depth/none.png\n")
    source = open_tum(tum)
    assert len(list(source.frames())) == 2
    assert source.notes == ("1 depth pictures without a colour picture at their time are left out",)


def test_stamps_of_another_clock_are_refused_by_file(tum: Path) -> None:
    (tum / "rgb.txt").write_text("1.0 rgb/a.png\n2.0 rgb/b.png\n")
    with pytest.raises(InputError, match=r"0 of 2 stamps of .*depth.txt are in .*rgb.txt, .* in one clock"):
        open_tum(tum)


def _without(name: str):
    return lambda path: (path / name).unlink()


def _with(name: str, content: object):
    return lambda path: write_json(path / name, content)


def _with_text(name: str, text: str):
    return lambda path: (path / name).write_text(text)


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (_without("camera.json"), r'camera\.json cannot be read .*; write \{"width": 640'),
        (_with("camera.json", {"width": 32, "height": 24}), r"camera\.json lacks 'fx'; write width"),
        (_with("camera.json", CAMERA | {"fx": 0}), r"camera\.json has focal length 0"),
        (
            _with("camera.json", CAMERA | {"depth_scale": 0}),
            r"camera\.json has depth_scale 0; write the",
        ),
        (_with("camera.json", []), r"camera\.json holds a list; write"),
        (_without("masks/instances.json"), r'instances\.json cannot be read .*; write \{"1": "mug"'),
        (_with("masks/instances.json", {"one": "mug"}), r"instances\.json: .*'one'; write"),
        (_with("masks/instances.json", {"0": "mug"}), r"instances\.json has label 0, which no mask"),
        (_with("masks/instances.json", {"1305031102.180304": 1, "b": {}}), r"has no labels for 1305031102"),
        (_with_text("masks/instances.json", "{"), r"instances\.json is no JSON"),
        (_with_text("masks/instances.json", "[" * 10**5), r"instances\.json is no JSON"),
        (
            _with("camera.json", CAMERA | {"width": float("inf")}),
            r"camera\.json has a wrong entry \(cannot convert",
        ),
        (_without("masks/1305031102.180304.png"), r"180304\.png does not exist; rgb\.txt asks"),
        (_with_text("depth.txt", f"{STAMPS_S[0]} {'9' * 400}\n"), r"9 does not exist; depth"),
        (_with_text("depth.txt", "# nothing\n"), r"depth\.txt is not `stamp_s picture` a line"),
        (_with_text("depth.txt", "today depth/a.png\n"), r"depth\.txt: 'today' is no stamp; write seconds"),
        (_with_text("depth.txt", "1305031102175304 depth/a.png\n"), r"'1305031102175304' is no stamp; write"),
        (_with_text("depth.txt", "-1.0 depth/a.png\n"), r"depth\.txt: '-1.0' is no stamp"),
        (_with_text("groundtruth.txt", "nan 1 2 3 0 0 0 1\n"), r"groundtruth\.txt: 'nan' is no stamp"),
        (_with("camera.json", CAMERA | {"depth_scale": float("inf")}), r"camera\.json has depth_scale inf"),
        (_with_text("groundtruth.txt", "1.0 2 3\n"), r"groundtruth\.txt is not `stamp_s x y z"),
        (_with_text("groundtruth.txt", "1.0 1 2 3 0 0 0 0\n"), r"groundtruth\.txt is not `stamp_s x y z"),
    ],
)
def test_what_is_missing_or_wrong_is_told_by_file(tum: Path, spoil, told: str) -> None:
    spoil(tum)
    with pytest.raises(InputError, match=told):
        list(open_tum(tum).frames())


def test_list_that_cannot_be_read_is_told(tum: Path) -> None:
    (tum / "rgb.txt").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"rgb\.txt cannot be read"):
        open_tum(tum)


def test_picture_that_claims_an_absurd_size_is_refused_before_memory_is_taken(tum: Path) -> None:
    picture = tum / "depth" / f"{STAMPS_S[0]}.png"
    data = bytearray(picture.read_bytes())
    data[16:24] = bytes([0, 1, 0, 0, 0, 1, 0, 0])  # 65536 x 65536
    picture.write_bytes(data)
    with pytest.raises(InputError, match="claims to be 65536 x 65536 pixels"):
        list(open_tum(tum).frames())


def test_picture_with_a_part_of_absurd_size_is_refused_before_memory_is_taken(tum: Path) -> None:
    picture = tum / "depth" / f"{STAMPS_S[0]}.png"
    data = bytearray(picture.read_bytes())
    data[33] = 0x4B  # length of the second part: over a gigabyte
    picture.write_bytes(data)
    with pytest.raises(InputError, match="a part of it is missing"):
        list(open_tum(tum).frames())


def test_depth_of_eight_bits_is_refused(tum: Path) -> None:
    write_picture(tum / "depth" / f"{STAMPS_S[0]}.png", depth(100).astype(np.uint8))
    with pytest.raises(InputError, match=r"8 bit; depth\.txt wants 32 x 24 pixels, 1 channel\(s\) of 16 bit"):
        list(open_tum(tum).frames())


@pytest.mark.parametrize("name", ["odometry.txt", "groundtruth.txt"])
def test_poses_of_another_clock_are_refused_by_file(tum: Path, name: str) -> None:
    (tum / name).write_text("12.5 1 2 3 0 0 0 1\n")
    with pytest.raises(InputError, match=rf"{name}: no pose is at the time of a frame: .*; write its stamps"):
        open_tum(tum)
