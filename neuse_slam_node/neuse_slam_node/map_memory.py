"""What the mapper knew last, for a mapper that was ended and started again."""

from neuse_encoder_node.conversions import stamp_from_msg
from neuse_msgs.msg import MapObject, ObjectMap

NEVER_NS = 2**63


class MapMemory:
    """Keeps the last map that was heard.

    A map never forgets: removed objects stay listed, of two that are merged the earlier stamp is kept, and
    objects are only seen more often. So a map that begins later than the one before, or has seen an object
    less often, is of a mapper that has started anew, with nothing or with a saved map.
    """

    def __init__(self) -> None:
        self._last: ObjectMap | None = None

    def hear(self, message: ObjectMap) -> ObjectMap | None:
        """The map to give back to a mapper that has lost it; None for one that has lost nothing."""
        last, self._last = self._last, message
        return last if last is not None and _knows_more(last, message) else None

    def forget(self) -> None:
        """A new run begins."""
        self._last = None


def _knows_more(last: ObjectMap, message: ObjectMap) -> bool:
    seen = {_name(known): known.n_observations for known in last.objects}
    fewer = any(known.n_observations < seen.get(_name(known), 0) for known in message.objects)
    return fewer or _began_ns(last) < _began_ns(message)


def _name(known: MapObject) -> tuple[int, int]:
    """Of an object in all maps of one session."""
    return known.object_id, stamp_from_msg(known.first_seen)


def _began_ns(message: ObjectMap) -> int:
    return min((stamp_from_msg(known.first_seen) for known in message.objects), default=NEVER_NS)
