"""What the mapper knew last, for a mapper that was ended and started again."""

import time

from neuse_encoder_node.conversions import stamp_from_msg
from neuse_msgs.msg import MapObject, ObjectMap

NEVER_NS = 2**63
PATIENCE_S = 10.0  # with a mapper that does not take it


class MapMemory:
    """Keeps the last map that was heard.

    A map never forgets: removed objects stay listed, of two that are merged the earlier stamp is kept, and
    objects are only seen more often. So a map that begins later than the one before, or has seen an object
    less often, is of a mapper that has started anew, with nothing or with a saved map.
    """

    def __init__(self) -> None:
        self.forget()

    def hear(self, message: ObjectMap) -> ObjectMap | None:
        """The map to give back to a mapper that has lost it; None for one that has lost nothing.

        A mapper that has just started may be heard before it hears: it gets the old map until its own tells
        that it knows it. One that does not take it, as it was reset, has its way after a while.
        """
        now_s = time.monotonic()
        if self._last is not None and _knows_more(self._last, message):
            self._lost_s = now_s if self._lost_s is None else self._lost_s
            if now_s - self._lost_s <= PATIENCE_S:
                return self._last
        self._last, self._lost_s = message, None
        return None

    def forget(self) -> None:
        """A new run begins."""
        self._last: ObjectMap | None = None
        self._lost_s: float | None = None


def _knows_more(last: ObjectMap, message: ObjectMap) -> bool:
    seen = {_name(known): known.n_observations for known in last.objects}
    fewer = any(known.n_observations < seen.get(_name(known), 0) for known in message.objects)
    return fewer or _began_ns(last) < _began_ns(message)


def _name(known: MapObject) -> tuple[int, int]:
    """Of an object in all maps of one session."""
    return known.object_id, stamp_from_msg(known.first_seen)


def _began_ns(message: ObjectMap) -> int:
    return min((stamp_from_msg(known.first_seen) for known in message.objects), default=NEVER_NS)
