"""What is fuzzed, and how one input is judged."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import Any

from hypothesis import strategies as st

from neuse.errors import NeuseError

LIMIT_S = 1.0  # of processor time, for one input
REFUSED, HARMLESS = "refused", "harmless"


@dataclass(frozen=True)
class Target:
    """One reader.

    spoiled: malformed inputs.    read: what takes them in; raises where an answer is nonsense.
    A NeuseError is the right answer. An input that `read` takes and finds sound was harmless after all.
    """

    name: str
    spoiled: st.SearchStrategy[Any]
    read: Callable[[Any], None]

    def judge(self, given: Any) -> str:
        """REFUSED or HARMLESS; whatever else the reader does is raised."""
        with _limited(self.name):
            try:
                self.read(given)
            except NeuseError as error:
                if not str(error).strip():
                    raise AssertionError("an error without a message") from error
                return REFUSED
        return HARMLESS


class HangError(AssertionError):
    """An input took too long."""


@contextmanager
def _limited(name: str) -> Iterator[None]:
    def stop(number: int, frame: FrameType | None) -> None:
        raise HangError(f"{name} took over {LIMIT_S} s of processor time")

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, LIMIT_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
