"""Detections of vision_msgs as the instances of a mask. Optional: vision_msgs is no wheel."""

from collections.abc import Mapping, Sequence
from typing import Any

from neuse.errors import InputError, ParamError
from neuse.records import Instance
from neuse_encoder_node.conversions import instances_to_msg
from neuse_msgs.msg import InstanceArray

try:
    from vision_msgs.msg import Detection2DArray
except ImportError:
    Detection2DArray = None


def instances_from_detections(message: Any, categories: Mapping[str, str]) -> InstanceArray:
    """What the labels of a mask are, from a vision_msgs/Detection2DArray of the mask's stamp.

    The label of a detection is its `id`; where no detection has one, its place in the array from 1 on. Its
    category is the class of its best hypothesis, by another name where `categories` has one; a detection
    without hypotheses is left out.

    Raises:
        InputError: `detection_id`, an id is no positive whole number.
    """
    numbered = any(detection.id for detection in message.detections)
    instances = []
    for place, detection in enumerate(message.detections, start=1):
        label = _label(detection.id) if numbered else place
        best = max((r.hypothesis for r in detection.results), key=lambda h: h.score, default=None)
        if best is not None:
            category = categories.get(best.class_id, best.class_id)
            instances.append(Instance(label, category, best.score))
    return instances_to_msg(tuple(instances), message.header)


def category_names(entries: Sequence[str]) -> dict[str, str]:
    """Categories by the detector's names, from entries `name=category`.

    Raises:
        ParamError: an entry is none.
    """
    pairs = [entry.partition("=") for entry in entries]
    for entry, (name, _, category) in zip(entries, pairs, strict=True):
        if not name or not category:
            raise ParamError(f"parameter detection_classes has {entry!r}; write name=category")
    return {name: category for name, _, category in pairs}


def _label(text: str) -> int:
    if not text.isdecimal() or len(text) > 20 or not 0 < int(text) < 2**32:
        found = f"detection has id {text[:40]!r}"
        raise InputError("detection_id", f"{found}; send its label in the mask, from 1 on")
    return int(text)
