import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from neuse.errors import BagError
from neuse_bags.definitions import is_installed_alike, message_class, message_definition, split_type


@pytest.mark.parametrize("name", ["sensor_msgs/msg/CameraInfo", "visualization_msgs/msg/MarkerArray"])
def test_definition_holds_every_type_inside_as_rosbags_knows_it(name: str) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    parsed = get_types_from_msg(message_definition(name), name)
    assert name in parsed
    for inner, (constants, fields) in parsed.items():
        known_constants, known_fields = store.fielddefs[inner]
        assert [(c[0], c[2]) for c in constants] == [(c[0], c[2]) for c in known_constants]
        assert fields == known_fields


def test_definition_of_our_own_messages_follows_bounded_arrays_of_other_packages() -> None:
    headings = [
        line for line in message_definition("neuse_msgs/msg/ObjectChange").splitlines() if "MSG:" in line
    ]
    assert "MSG: geometry_msgs/Pose" in headings
    assert len(headings) == len(set(headings))


def test_only_a_change_of_fields_makes_a_definition_another_one() -> None:
    name = "neuse_msgs/msg/Code"
    text = message_definition(name)
    assert is_installed_alike(name, text)
    assert is_installed_alike(name, f"# a remark\nuint8 MEANING=1\n{text}")
    assert not is_installed_alike(name, text.replace("float64[6] sigmas", "float64[5] sigmas"))
    assert not is_installed_alike(name, "string category\n")


def test_types_that_are_not_installed_are_no_other_definition() -> None:
    assert is_installed_alike("nobody_msgs/msg/Nothing", "uint8 x\n")


@pytest.mark.parametrize("name", ["nobody_msgs/msg/Nothing", "sensor_msgs/msg/Nothing"])
def test_type_that_is_not_installed_is_refused_by_name(name: str) -> None:
    with pytest.raises(BagError, match=name):
        message_definition(name)
    with pytest.raises(BagError, match=name):
        message_class(name)


@pytest.mark.parametrize("name", ["Image", "sensor_msgs/Image", "a/srv/B", "/msg/Image"])
def test_what_is_no_message_type_is_refused(name: str) -> None:
    with pytest.raises(BagError, match="is no message type"):
        split_type(name)
