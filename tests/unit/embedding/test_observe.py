from dataclasses import replace

import numpy as np
import pytest

from neuse.embedding.code import Code
from neuse.embedding.embedding import Embedding
from neuse.embedding.observe import Observer, ObserverParams, back_project, coarse_depth
from neuse.errors import InputError, ParamError
from neuse.records import Instance, Intrinsics, RgbdFrame

from .tiny import make_code, make_network

CAMERA = Intrinsics(64, 48, 60.0, 62.0, 31.5, 23.5)
BOXES = {1: (5, 20, 5, 20), 2: (25, 40, 5, 20), 3: (10, 30, 30, 50)}  # label -> rows and columns of its mask
WALL_M = 2.0


class FakeEmbedding:
    """Codes whose centre is the mean of the points plus `offset`; remembers the clouds and shares."""

    def __init__(self, category, offset=0.0):
        self.category, self.offset, self.clouds, self.shares = category, offset, [], []

    def encode(self, clouds, share=1.0):
        self.shares.append(share)
        self.clouds += clouds
        return [self._code(cloud) for cloud in clouds]

    def _code(self, cloud) -> Code:
        T = np.eye(4)
        T[:3, 3] = cloud.mean(axis=0) + self.offset
        return make_code(T, self.category)


@pytest.fixture
def fakes():
    return {category: FakeEmbedding(category) for category in ("mug", "bottle")}


@pytest.fixture
def observer(fakes):
    return Observer(embeddings=fakes)


@pytest.fixture
def frame():
    """A mug, a bottle and a mug, each a slanted patch about a metre away, before a wall."""
    depth_m, mask = np.full((48, 64), WALL_M, dtype=np.float32), np.zeros((48, 64), dtype=np.uint8)
    rows = np.arange(48, dtype=np.float32)[:, None] + np.zeros((1, 64), dtype=np.float32)
    for label, box in BOXES.items():
        mask[region(box)] = label
        depth_m[region(box)] = (0.9 + 0.1 * label + 0.001 * rows)[region(box)]
    instances = (Instance(1, "mug", 0.9), Instance(2, "bottle", 0.8), Instance(3, "mug", 0.7))
    return RgbdFrame(12345, depth_m, mask, instances, CAMERA)


def region(box):
    return np.s_[box[0] : box[1], box[2] : box[3]]


def changed(frame, name, where, value):
    """The frame with part of its depth or mask replaced."""
    array = getattr(frame, name).copy()
    array[where] = value
    return replace(frame, **{name: array})


def labels(observed):
    return [observation.label for observation in observed.observations]


def reasons(observed):
    return [rejection.reason for rejection in observed.rejections]


def test_observations_come_in_the_order_of_the_instances(observer, frame):
    for order in ((0, 1, 2), (2, 1, 0), (1, 0, 2)):
        instances = tuple(frame.instances[i] for i in order)
        observed = observer.observe(replace(frame, instances=instances))
        found = [(o.label, o.code.category, o.score) for o in observed.observations]
        assert found == [(i.label, i.category, i.score) for i in instances]
        assert observed.rejections == ()


def test_all_objects_of_a_category_are_encoded_in_one_batch(frame, fakes, monkeypatch):
    calls = []
    for fake in fakes.values():
        encode = fake.encode
        monkeypatch.setattr(
            fake, "encode", lambda clouds, _, encode=encode: calls.append(len(clouds)) or encode(clouds)
        )
    Observer(embeddings=fakes).observe(frame)
    assert sorted(calls) == [1, 2]


def test_encoded_points_are_those_under_the_mask_in_the_camera_frame(observer, frame, fakes):
    observer.observe(frame)
    (cloud,) = fakes["bottle"].clouds
    rows, columns = np.mgrid[region(BOXES[2])]
    z = frame.depth_m[region(BOXES[2])].astype(float)
    expected = np.stack([(columns - 31.5) / 60.0 * z, (rows - 23.5) / 62.0 * z, z], -1).reshape(-1, 3)
    np.testing.assert_allclose(cloud, expected, atol=1e-12)


def test_observation_describes_what_was_encoded(observer, frame, fakes):
    observation = observer.observe(frame).observations[1]
    (cloud,) = fakes["bottle"].clouds
    np.testing.assert_allclose(observation.partial_center, cloud.mean(axis=0))
    assert observation.mask_px == 15 * 15
    assert observation.cloud.dtype == np.float32
    nearest = np.linalg.norm(observation.cloud[:, None] - cloud[None], axis=-1).min(axis=1)
    assert nearest.max() < 1e-6
    assert not observation.touches_border


def test_share_that_is_looked_at_reaches_all_embeddings(observer, frame, fakes):
    observer.observe(frame, share=0.5)
    observer.observe(frame)
    assert [fake.shares for fake in fakes.values()] == [[0.5, 1.0]] * 2


def test_cloud_that_goes_along_is_limited(frame, fakes):
    observed = Observer(ObserverParams(cloud_points=50), fakes).observe(frame)
    assert [len(o.cloud) for o in observed.observations] == [50, 50, 50]


@pytest.mark.parametrize("where", [np.s_[0, 10], np.s_[47, 10], np.s_[10, 0], np.s_[10, 63]], ids=str)
def test_mask_that_reaches_the_border_is_marked(observer, frame, where):
    observed = observer.observe(changed(frame, "mask", where, 1))
    assert [o.touches_border for o in observed.observations] == [True, False, False]


def test_observed_frame_keeps_stamp_and_intrinsics(observer, frame):
    observed = observer.observe(frame)
    assert (observed.stamp_ns, observed.intrinsics) == (12345, CAMERA)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.int32, np.int64])
def test_every_integer_type_of_mask_is_understood(observer, frame, dtype):
    assert labels(observer.observe(replace(frame, mask=frame.mask.astype(dtype)))) == [1, 2, 3]


def test_real_embeddings_give_codes_near_their_points(frame):
    observer = Observer(embeddings={name: Embedding(make_network(name)) for name in ("mug", "bottle")})
    observed = observer.observe(frame)
    assert labels(observed) + [0] * len(observed.rejections) != []
    for observation in observed.observations:
        assert np.linalg.norm(observation.code.center - observation.partial_center) < 0.5


def test_frame_without_instances_has_no_observations(observer, frame):
    empty = replace(frame, mask=np.zeros_like(frame.mask), instances=())
    observed = observer.observe(empty)
    assert observed.observations == observed.rejections == ()


# what cannot be used of a frame


def test_background_under_the_mask_is_not_encoded(observer, frame, fakes):
    observer.observe(changed(frame, "depth_m", np.s_[25:28, 5:20], 5.0))
    assert fakes["bottle"].clouds[0][:, 2].max() < 1.3


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -1.0, 0.0, 6.5], ids=str)
def test_readings_that_are_none_are_left_out(observer, frame, fakes, value):
    observed = observer.observe(changed(frame, "depth_m", np.s_[25:30, 5:20], value))
    assert labels(observed) == [1, 2, 3]
    assert len(fakes["bottle"].clouds[0]) == 10 * 15


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 0.0, 6.5], ids=str)
def test_instance_without_readings_is_rejected_and_the_others_kept(observer, frame, value):
    observed = observer.observe(changed(frame, "depth_m", region(BOXES[2]), value))
    assert labels(observed) == [1, 3]
    assert reasons(observed) == ["too_few_points"]
    assert "instance 2 (bottle): 0 of 225 px" in observed.rejections[0].detail


def test_image_of_no_readings_at_all_gives_no_observation(observer, frame):
    observed = observer.observe(replace(frame, depth_m=np.full_like(frame.depth_m, np.nan)))
    assert observed.observations == ()
    assert reasons(observed) == ["too_few_points"] * 3
    assert (observed.coarse_depth_m == 0).all()


def test_instance_of_an_unknown_category_is_rejected(observer, frame):
    instances = (replace(frame.instances[0], category="teapot"), *frame.instances[1:])
    observed = observer.observe(replace(frame, instances=instances))
    assert labels(observed) == [2, 3]
    assert reasons(observed) == ["unknown_category"]
    assert "known: mug, bottle" in observed.rejections[0].detail


def test_label_without_an_instance_is_rejected(observer, frame):
    observed = observer.observe(replace(frame, instances=frame.instances[:2]))
    assert labels(observed) == [1, 2]
    assert reasons(observed) == ["label_without_instance"]
    assert "label 3" in observed.rejections[0].detail


def test_instance_without_a_pixel_is_rejected(observer, frame):
    observed = observer.observe(changed(frame, "mask", region(BOXES[1]), 0))
    assert labels(observed) == [2, 3]
    assert reasons(observed) == ["empty_mask"]


def test_empty_mask_rejects_every_instance(observer, frame):
    observed = observer.observe(replace(frame, mask=np.zeros_like(frame.mask)))
    assert reasons(observed) == ["empty_mask"] * 3


def test_instance_that_claims_the_background_is_rejected(observer, frame):
    observed = observer.observe(replace(frame, instances=(*frame.instances, Instance(0, "mug"))))
    assert labels(observed) == [1, 2, 3]
    assert reasons(observed) == ["empty_mask"]


def test_mask_of_one_pixel_is_rejected(observer, frame):
    frame = changed(changed(frame, "mask", region(BOXES[1]), 0), "mask", (10, 10), 1)
    observed = observer.observe(frame)
    assert labels(observed) == [2, 3]
    assert reasons(observed) == ["too_few_points"]


def test_mask_over_the_whole_image_is_rejected(observer, frame):
    whole = replace(frame, mask=np.ones_like(frame.mask), instances=frame.instances[:1])
    observed = observer.observe(whole)
    assert observed.observations == ()
    assert reasons(observed) == ["mask_too_large"]
    assert "100%" in observed.rejections[0].detail


def test_too_large_mask_without_an_instance_is_counted_once(observer, frame):
    observed = observer.observe(replace(frame, mask=np.full_like(frame.mask, 7), instances=()))
    assert reasons(observed) == ["label_without_instance"]


def test_negative_label_is_rejected(observer, frame):
    mask = frame.mask.astype(np.int32)
    mask[0, :30] = -1
    observed = observer.observe(replace(frame, mask=mask))
    assert labels(observed) == [1, 2, 3]
    assert reasons(observed) == ["label_without_instance"]


@pytest.mark.parametrize("score", [0.2, np.nan])
def test_detection_below_the_wanted_score_is_rejected(frame, fakes, score):
    instances = (replace(frame.instances[0], score=score), *frame.instances[1:])
    observed = Observer(ObserverParams(min_score=0.5), fakes).observe(replace(frame, instances=instances))
    assert labels(observed) == [2, 3]
    assert reasons(observed) == ["low_score"]


def test_score_that_is_no_share_is_rejected(frame, fakes):
    instances = (replace(frame.instances[0], score=87.0), *frame.instances[1:])
    observed = Observer(embeddings=fakes).observe(replace(frame, instances=instances))
    assert labels(observed) == [2, 3]
    assert reasons(observed) == ["score_above_one"]


@pytest.mark.parametrize("offset", [0.6, np.nan])
def test_code_far_from_its_points_is_rejected(frame, fakes, offset):
    fakes["bottle"].offset = offset
    observed = Observer(embeddings=fakes).observe(frame)
    assert labels(observed) == [1, 3]
    assert reasons(observed) == ["unsound_code"]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"mask": np.zeros((24, 32), dtype=np.uint8)}, "size_mismatch"),
        ({"depth_m": np.ones((48, 64, 1), dtype=np.float32)}, "size_mismatch"),
        ({"depth_m": np.ones(48 * 64, dtype=np.float32)}, "size_mismatch"),
        ({"depth_m": np.ones((48, 64), dtype=np.uint16)}, "depth_type"),
        ({"mask": np.zeros((48, 64), dtype=np.float32)}, "mask_type"),
        ({"mask": np.zeros((48, 64), dtype=bool)}, "mask_type"),
        ({"intrinsics": replace(CAMERA, width=640, height=480)}, "intrinsics_size"),
        ({"intrinsics": Intrinsics(64, 48, 0.0, 0.0, 0.0, 0.0)}, "intrinsics"),
        ({"intrinsics": replace(CAMERA, fy=-60.0)}, "intrinsics"),
        ({"intrinsics": replace(CAMERA, cx=np.nan)}, "intrinsics"),
        ({"instances": (Instance(1, "mug"), Instance(1, "bottle"))}, "duplicate_label"),
    ],
    ids=lambda value: value if isinstance(value, str) else next(iter(value)),
)
def test_frame_that_cannot_be_used_is_refused(observer, frame, change, reason):
    with pytest.raises(InputError) as caught:
        observer.observe(replace(frame, **change))
    assert caught.value.reason == reason


@pytest.mark.parametrize(
    "change",
    [{"min_points": 1}, {"max_range_m": 0.0}, {"max_image_share": 1.5}, {"coarse_width": 0}],
    ids=str,
)
def test_parameter_outside_its_range_is_refused(change):
    with pytest.raises(ParamError, match=next(iter(change))):
        ObserverParams(**change)


def test_back_projection_is_inverted_by_the_pinhole_camera(frame):
    pixels = np.random.default_rng(0).choice(48 * 64, 100, replace=False)
    points = back_project(frame.depth_m, CAMERA, pixels, 6.0)
    u = points[:, 0] / points[:, 2] * CAMERA.fx + CAMERA.cx
    v = points[:, 1] / points[:, 2] * CAMERA.fy + CAMERA.cy
    np.testing.assert_allclose(np.round(v) * 64 + np.round(u), pixels)
    np.testing.assert_allclose(points[:, 2], frame.depth_m.ravel()[pixels])


@pytest.mark.parametrize("size", [(16, 12), (80, 60), (7, 5), (64, 48)], ids=str)
def test_thumbnail_pixels_are_the_documented_image_pixels(frame, size):
    width, height = size
    image = np.arange(48 * 64, dtype=np.float32).reshape(48, 64) + 1
    thumbnail = coarse_depth(image, width, height)
    assert thumbnail.shape == (height, width)
    for v, u in [(0, 0), (height - 1, width - 1), (height // 2, width // 3)]:
        row, column = int((v + 0.5) * 48 / height), int((u + 0.5) * 64 / width)
        assert thumbnail[v, u] == image[row, column]


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0, 0.0])
def test_thumbnail_has_zero_where_there_is_no_reading(value):
    assert (coarse_depth(np.full((48, 64), value, dtype=np.float32), 8, 6) == 0.0).all()


def test_observed_thumbnail_has_the_size_of_the_parameters(frame, fakes):
    observed = Observer(ObserverParams(coarse_width=16, coarse_height=12), fakes).observe(frame)
    np.testing.assert_array_equal(observed.coarse_depth_m, coarse_depth(frame.depth_m, 16, 12))
    assert observed.coarse_depth_m.dtype == np.float32
