import numpy as np
import pytest

from neuse.errors import InputError, MeshError
from neuse.mapping.mapper import ObjectMapper
from neuse.records import ObjectMap

from .synthetic import RECONSTRUCT, World, decode, five_things, make_world, orbit


class CountingDecoders(dict):
    """Decoders of all categories that count."""

    def __init__(self) -> None:
        super().__init__(dict.fromkeys(RECONSTRUCT, self._decode))
        self.calls = 0

    def _decode(self, code):
        self.calls += 1
        return decode(code)


def toured(decoders: CountingDecoders, count: int = 16) -> World:
    world = make_world(five_things(), ObjectMapper(decoders))
    world.tour(orbit(count=count))
    return world


def boxes(object_map: ObjectMap) -> np.ndarray:
    return np.array([[known.box_center, known.box_size] for known in object_map.objects])


def test_sketch_decodes_nothing_and_is_the_map_but_for_its_boxes():
    decoders = CountingDecoders()
    mapper = toured(decoders).mapper
    before = decoders.calls
    sketch = mapper.sketch
    assert decoders.calls == before
    exact = mapper.object_map
    assert decoders.calls > before
    for one, other in zip(sketch.objects, exact.objects, strict=True):
        assert (one.object_id, one.status, one.n_observations) == (
            other.object_id,
            other.status,
            other.n_observations,
        )
        assert np.linalg.norm(one.box_center - other.box_center) < 0.05


def test_shapes_are_decoded_one_at_a_time_until_the_sketch_is_the_map():
    decoders = CountingDecoders()
    mapper = toured(decoders).mapper
    calls = decoders.calls
    while mapper.decode_next():
        calls += 1
        assert decoders.calls == calls
    sketch = mapper.sketch
    np.testing.assert_array_equal(boxes(sketch), boxes(mapper.object_map))
    assert decoders.calls == calls
    assert not mapper.decode_next()


def test_objects_seen_only_a_few_times_are_not_decoded_yet():
    decoders = CountingDecoders()
    mapper = toured(decoders, count=3).mapper
    assert len(mapper.sketch.objects) > 0
    assert not mapper.decode_next()
    assert decoders.calls == 0


def test_mesh_without_time_is_there_once_it_has_been_decoded():
    mapper = toured(CountingDecoders()).mapper
    object_id = mapper.sketch.objects[0].object_id
    with pytest.raises(InputError, match="99"):
        mapper.mesh(99, now=False)
    fresh = ObjectMapper(RECONSTRUCT)
    fresh.recall(ObjectMap(0, mapper.sketch.objects))
    with pytest.raises(MeshError, match="not been decoded"):
        fresh.mesh(object_id, now=False)
    while mapper.decode_next():
        pass
    assert mapper.mesh(object_id, now=False).volume == pytest.approx(mapper.mesh(object_id).volume)
