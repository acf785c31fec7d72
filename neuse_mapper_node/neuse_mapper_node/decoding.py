"""Shapes are brought up to date one by one, in a share of the time."""

import time

from neuse.mapping.mapper import ObjectMapper


class Decoding:
    """Decodes a shape when it is asked for it and the last one is long enough ago."""

    def __init__(self, mapper: ObjectMapper, share: float) -> None:
        self._mapper, self._share = mapper, share
        self._next_s, self._is_open = 0.0, False

    def go_on(self) -> bool:
        """Decode a shape if it is time; whether this has shown that all that lagged behind are up to date."""
        started_s = time.monotonic()
        if started_s < self._next_s:
            return False
        was_open, self._is_open = self._is_open, self._mapper.decode_next()
        self._next_s = started_s + (time.monotonic() - started_s) / self._share
        return was_open and not self._is_open
