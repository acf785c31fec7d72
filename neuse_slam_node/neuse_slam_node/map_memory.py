"""What the mapper knew last, for a mapper that was ended and started again."""

from neuse_encoder_node.conversions import stamp_from_msg
from neuse_msgs.msg import ObjectMap

NEVER_NS = 2**63


class MapMemory:
    """Keeps the last map that was heard.

    A map never forgets when its first object was seen: removed objects stay listed, and of two that are
    merged the earlier stamp is kept. So a map that begins later than the one before is of a mapper that has
    started anew.
    """

    def __init__(self) -> None:
        self._last: ObjectMap | None = None

    def hear(self, message: ObjectMap) -> ObjectMap | None:
        """The map to give back to a mapper that has lost it; None for one that has lost nothing."""
        last, self._last = self._last, message
        return last if last is not None and _began_ns(last) < _began_ns(message) else None

    def forget(self) -> None:
        """A new run begins."""
        self._last = None


def _began_ns(message: ObjectMap) -> int:
    return min((stamp_from_msg(known.first_seen) for known in message.objects), default=NEVER_NS)
