"""The recorder as a process of its own, fed over DDS."""

import os
import signal
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

import pytest
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String, UInt32

from neuse_bags.mcap_file import BagReader
from neuse_bags.qos import LATCHED
from neuse_msgs.msg import ObjectChange

pytestmark = pytest.mark.ros

WAIT_S = 120.0
BEST_EFFORT = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)


@dataclass
class Session:
    """One recording and what it was fed."""

    path: Path
    changes: list[ObjectChange]
    output: str
    code: int


def _wait_for_recorder(publisher: Publisher) -> None:
    deadline_s = time.monotonic() + WAIT_S
    while publisher.get_subscription_count() == 0:
        assert time.monotonic() < deadline_s, f"nobody subscribed to {publisher.topic_name}"
        time.sleep(0.05)


def _end(process: subprocess.Popen, number: signal.Signals) -> str:
    process.send_signal(number)
    output, errors = process.communicate(timeout=WAIT_S)
    return output + errors


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory, node: Node, start_bags) -> Session:
    """Topics that are there before, appear later, are best effort, latched, or not asked for."""
    path = tmp_path_factory.mktemp("record") / "session.mcap"
    latched = node.create_publisher(String, "early", LATCHED)
    latched.publish(String(data="before the recorder"))
    other = node.create_publisher(String, "other", 10)
    process = start_bags("record", "--out", path, "early", "neuse/changes", "unsure", "never")
    _wait_for_recorder(latched)
    late = node.create_publisher(ObjectChange, "neuse/changes", 100)
    unsure = node.create_publisher(UInt32, "unsure", BEST_EFFORT)
    _wait_for_recorder(late)
    _wait_for_recorder(unsure)
    changes = [ObjectChange(object_id=index, category="mug") for index in range(30)]
    for change in changes:
        late.publish(change)
    unsure.publish(UInt32(data=3))
    other.publish(String(data="not asked for"))
    late.wait_for_all_acked()
    return Session(path, changes, _end(process, signal.SIGINT), process.returncode)


def test_bag_is_whole_after_ctrl_c_and_holds_every_message(session: Session) -> None:
    assert session.code == 0
    with BagReader(session.path) as bag:
        recorded = [message.decode() for message in bag.messages(["/neuse/changes"])]
    assert recorded == session.changes


def test_latched_message_from_before_the_recorder_is_kept_latched(session: Session) -> None:
    with BagReader(session.path) as bag:
        (message,) = bag.messages(["/early"])
        assert bag.topics["/early"].qos[0].durability == DurabilityPolicy.TRANSIENT_LOCAL
    assert message.decode().data == "before the recorder"


def test_best_effort_publisher_is_recorded_as_such(session: Session) -> None:
    with BagReader(session.path) as bag:
        assert bag.topics["/unsure"].qos[0].reliability == ReliabilityPolicy.BEST_EFFORT
        assert [message.decode().data for message in bag.messages(["/unsure"])] == [3]


def test_topic_that_was_not_asked_for_is_left_out(session: Session) -> None:
    with BagReader(session.path) as bag:
        assert set(bag.topics) == {"/early", "/neuse/changes", "/unsure"}


def test_recorder_counts_each_topic_and_names_what_never_came(session: Session) -> None:
    assert "      30  /neuse/changes" in session.output
    assert "never published: /never" in session.output


def test_existing_bag_is_not_overwritten_unasked(session: Session, start_bags) -> None:
    process = start_bags("record", "--out", session.path)
    _, errors = process.communicate(timeout=WAIT_S)
    assert process.returncode == 2
    assert "exists" in errors
    assert "--overwrite" in errors


def test_default_choice_is_what_the_nodes_put_out_and_sigterm_ends_it_whole(
    session: Session, node: Node, start_bags, tmp_path: Path
) -> None:
    mapped = node.create_publisher(String, "robot/neuse/map", 10)
    process = start_bags("record", "--out", tmp_path / "default.mcap")
    _wait_for_recorder(mapped)
    mapped.publish(String(data="map"))
    mapped.wait_for_all_acked()
    _end(process, signal.SIGTERM)
    assert process.returncode == 0
    with BagReader(tmp_path / "default.mcap") as bag:
        assert bag.topics["/robot/neuse/map"].n_messages == 1
        assert not {"/early", "/other", "/unsure"} & bag.topics.keys()


def test_full_disk_ends_the_recorder_with_one_line(
    session: Session, node: Node, start_bags, tmp_path: Path
) -> None:
    full = tmp_path / "full.mcap"
    full.symlink_to("/dev/full")
    texts = node.create_publisher(String, "texts", 100)
    process = start_bags("record", "--out", full, "--overwrite", "texts")
    _wait_for_recorder(texts)
    for _ in range(12):
        texts.publish(String(data=os.urandom(2**19).hex()))
    _, errors = process.communicate(timeout=WAIT_S)
    assert process.returncode == 2
    assert "No space left on device" in errors
    assert "mcap recover" in errors
    assert "Traceback" not in errors
