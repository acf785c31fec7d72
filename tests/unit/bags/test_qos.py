import pytest
from rclpy.duration import Duration
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosbags.rosbag2.metadata import parse_qos

from neuse_bags.qos import LATCHED, RELIABLE, SENSOR, qos_from_rosbags, qos_to_yaml


def _round_trip(profile: QoSProfile) -> QoSProfile:
    """Through the text that rosbags, too, reads and normalises."""
    (parsed,) = parse_qos(qos_to_yaml([profile]))
    return qos_from_rosbags(parsed)


@pytest.mark.parametrize(
    "profile", [SENSOR, RELIABLE, LATCHED, QoSProfile(depth=3, deadline=Duration(seconds=2))]
)
def test_profile_survives_the_way_through_a_bag(profile: QoSProfile) -> None:
    assert _round_trip(profile) == profile


def test_what_a_bag_leaves_unknown_becomes_a_default_that_can_be_offered() -> None:
    unknown = QoSProfile(depth=0, history=HistoryPolicy.UNKNOWN, reliability=ReliabilityPolicy.UNKNOWN)
    offered = _round_trip(unknown)
    assert (offered.history, offered.reliability) == (HistoryPolicy.KEEP_LAST, ReliabilityPolicy.RELIABLE)
    assert offered.depth > 0


def test_policies_as_numbers_are_understood_as_older_bags_have_them() -> None:
    text = (
        qos_to_yaml([SENSOR]).replace("best_effort", "2").replace("volatile", "2").replace("keep_last", "1")
    )
    (parsed,) = parse_qos(text)
    read = qos_from_rosbags(parsed)
    assert (read.reliability, read.durability, read.history) == (
        SENSOR.reliability,
        SENSOR.durability,
        SENSOR.history,
    )
