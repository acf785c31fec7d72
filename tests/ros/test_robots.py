"""Two robots, nodes in a namespace each, share one mapper: the second finds its place in the map."""

from pathlib import Path

import pytest

from neuse.records import ObjectStatus
from neuse_bags import simulate, topics
from neuse_bags.demo import record_graph
from neuse_bags.mcap_file import BagReader
from neuse_bags.robots import robots_report
from neuse_mapper_node.conversions import object_map_from_msg
from neuse_slam_node.conversions import tracked_frame_from_msg

pytestmark = [pytest.mark.ros, pytest.mark.slow]

N_FRAMES = 120
BAR_M, BAR_DEG = 0.05, 2.0
ROBOTS = ("/a", "/b")


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory, domain: int) -> tuple[Path, Path]:
    """What the nodes published, and the bag that they heard."""
    folder = tmp_path_factory.mktemp("robots")
    bag, told = folder / "robots.mcap", folder / "recording.mcap"
    cameras = ["--cameras", "2", "--frames", str(N_FRAMES), "--out", str(bag)]
    assert simulate.main(["tabletop", "--seed", "3", *cameras]) == 0
    record_graph(bag, told, rate=1.0, logs=folder / "logs", namespaces=ROBOTS)
    return told, bag


def test_both_are_in_one_map_where_they_are(bags: tuple[Path, Path]):
    with BagReader(bags[0]) as told, BagReader(bags[1]) as played:
        report = robots_report(told, played)
    assert tuple(report["robots"]) == ROBOTS
    for name, robot in report["robots"].items():
        assert robot["mapped"] == robot["frames"] == N_FRAMES, name
        assert robot["median_m"] <= BAR_M, name
        assert robot["median_deg"] <= BAR_DEG, name


def test_objects_have_one_name_for_both(bags: tuple[Path, Path]):
    with BagReader(bags[0]) as told:
        seen_by = [named_objects(told, name) for name in ROBOTS]
        maps = [message.decode() for message in told.messages([topics.MAP.name])]
    known = object_map_from_msg(maps[-1]).objects
    present = {item.object_id for item in known if item.status != ObjectStatus.REMOVED}
    both = present & seen_by[0] & seen_by[1]
    assert len(both) >= 8  # of twelve that stand on one table
    assert len(present) <= 12  # none is there twice


def named_objects(told: BagReader, namespace: str) -> set[int]:
    """Ids by which a robot's frames call what they see."""
    messages = told.messages([namespace + topics.FRAMES.name])
    frames = (tracked_frame_from_msg(message.decode()) for message in messages)
    return {tracked.object_id for frame in frames for tracked in frame.observations}
