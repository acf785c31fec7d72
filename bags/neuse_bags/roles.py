"""What the graph wants to hear: a role, its topic, and whether it can do without."""

from dataclasses import dataclass

from neuse_bags import topics
from neuse_bags.topics import TopicSpec


@dataclass(frozen=True)
class Role:
    """One part that a topic plays for the graph; `meaning` is for people."""

    name: str
    topic: TopicSpec
    meaning: str
    needed: bool = True


ROLES = (
    Role("depth", topics.DEPTH, "depth image, 16UC1 in mm or 32FC1 in m"),
    Role("camera", topics.DEPTH_INFO, "its intrinsics"),
    Role("mask", topics.MASK, "instance labels, 0 = background, with the depth's stamps"),
    Role("instances", topics.INSTANCES, "which label is of which category"),
    Role("odometry", topics.ODOMETRY, "motion between frames without objects", needed=False),
    Role("colour", topics.COLOR, "for people", needed=False),
    Role("colour camera", topics.COLOR_INFO, "its intrinsics", needed=False),
    Role("true poses", topics.TRUE_ODOMETRY, "for the evaluation", needed=False),
    Role("true map", topics.TRUE_MAP, "for the evaluation", needed=False),
    Role("true changes", topics.TRUE_CHANGES, "for the evaluation", needed=False),
    Role("traversals", topics.TRUE_TRAVERSAL, "for the evaluation", needed=False),
)
