"""Quality of service: what our topics offer, and how bags store it (offered_qos_profiles)."""

from enum import Enum
from typing import Any

import yaml
from rclpy.duration import Duration, Infinite
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from rosbags.interfaces import Qos, QosTime

# Our bags offer everything reliably: that serves subscribers of either kind, and no frame is lost under load.
SENSOR = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
RELIABLE = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def qos_to_yaml(profiles: list[QoSProfile]) -> str:
    """The list as rosbag2 writes it since metadata version 9 (policies as words)."""
    return yaml.safe_dump([_to_dict(profile) for profile in profiles], sort_keys=False)


def qos_from_rosbags(qos: Qos) -> QoSProfile:
    """A profile that a publisher can offer; what the bag leaves unknown becomes the default."""
    return QoSProfile(
        depth=qos.depth or RELIABLE.depth,
        history=_known(HistoryPolicy, qos.history, HistoryPolicy.KEEP_LAST),
        reliability=_known(ReliabilityPolicy, qos.reliability, ReliabilityPolicy.RELIABLE),
        durability=_known(DurabilityPolicy, qos.durability, DurabilityPolicy.VOLATILE),
        liveliness=_known(LivelinessPolicy, qos.liveliness, LivelinessPolicy.AUTOMATIC),
        deadline=_duration(qos.deadline),
        lifespan=_duration(qos.lifespan),
        liveliness_lease_duration=_duration(qos.liveliness_lease_duration),
        avoid_ros_namespace_conventions=qos.avoid_ros_namespace_conventions,
    )


def _known(kind: Any, policy: Enum, default: Any) -> Any:
    """rmw and rosbags number the policies alike; a publisher cannot offer `unknown` or `best available`."""
    return default if policy.name in ("UNKNOWN", "BEST_AVAILABLE") else kind(policy.value)


def _to_dict(profile: QoSProfile) -> dict[str, Any]:
    return {
        "history": profile.history.short_key,
        "depth": profile.depth,
        "reliability": profile.reliability.short_key,
        "durability": profile.durability.short_key,
        "deadline": _duration_to_dict(profile.deadline),
        "lifespan": _duration_to_dict(profile.lifespan),
        "liveliness": profile.liveliness.short_key,
        "liveliness_lease_duration": _duration_to_dict(profile.liveliness_lease_duration),
        "avoid_ros_namespace_conventions": profile.avoid_ros_namespace_conventions,
    }


def _duration_to_dict(duration: Duration) -> dict[str, int]:
    """Zero is rmw's word for `not set`; rosbag2 writes that as infinite."""
    nanoseconds = duration.nanoseconds or Infinite.nanoseconds
    return {"sec": nanoseconds // 10**9, "nsec": nanoseconds % 10**9}


def _duration(time: QosTime) -> Duration:
    nanoseconds = time.sec * 10**9 + time.nsec
    return Duration() if nanoseconds >= Infinite.nanoseconds else Duration(nanoseconds=nanoseconds)
