from types import SimpleNamespace

import pytest
from std_msgs.msg import Header

from neuse.errors import InputError, ParamError
from neuse_encoder_node.conversions import header_to_msg
from neuse_encoder_node.detections import category_names, instances_from_detections
from neuse_encoder_node.node import EncoderNodeParams


def detection(label: str, **scores: float) -> SimpleNamespace:
    """With the fields of a vision_msgs/Detection2D that are read."""
    results = [SimpleNamespace(hypothesis=SimpleNamespace(class_id=c, score=s)) for c, s in scores.items()]
    return SimpleNamespace(id=label, results=results)


def array(*detections: SimpleNamespace, header: Header | None = None) -> SimpleNamespace:
    return SimpleNamespace(header=header or Header(), detections=list(detections))


def entries(message: SimpleNamespace, **categories: str) -> list[tuple[int, str, float]]:
    found = instances_from_detections(message, categories)
    return [(item.label, item.category, item.score) for item in found.instances]


def test_ids_are_labels_and_the_best_hypothesis_is_the_category():
    message = array(detection("7", bowl=0.2, mug=0.7), detection("3", bottle=0.9))
    assert entries(message) == [(7, "mug", 0.7), (3, "bottle", 0.9)]


def test_classes_of_other_names_become_categories():
    assert entries(array(detection("1", cup=0.5), detection("2", vase=0.5)), cup="mug") == [
        (1, "mug", 0.5),
        (2, "vase", 0.5),
    ]


def test_without_ids_labels_are_places_in_the_array():
    message = array(detection("", mug=1.0), detection(""), detection("", bottle=1.0))
    assert entries(message) == [(1, "mug", 1.0), (3, "bottle", 1.0)]


def test_header_is_kept():
    header = header_to_msg(5_000_000_007, "camera")
    assert instances_from_detections(array(header=header), {}).header == header


@pytest.mark.parametrize("label", ["0", "-1", "a7c1", "1.5", "", str(2**32), "9" * 5000])
def test_id_that_is_no_label_is_refused(label: str):
    with pytest.raises(InputError, match=r"id .*; send its label in the mask") as refused:
        instances_from_detections(array(detection("4", mug=1.0), detection(label, mug=1.0)), {})
    assert refused.value.reason == "detection_id"


def test_names_of_classes_are_read_from_the_parameter():
    assert category_names(["cup=mug", "39=bottle"]) == {"cup": "mug", "39": "bottle"}
    assert category_names(EncoderNodeParams().detection_classes) == {"cup": "mug"}


@pytest.mark.parametrize("entry", ["cup", "=mug", "cup="])
def test_name_without_category_is_refused_by_the_parameter(entry: str):
    with pytest.raises(ParamError, match=rf"detection_classes has '{entry}'; write name=category"):
        EncoderNodeParams(detection_classes=("cup=mug", entry))
