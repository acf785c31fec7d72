"""Where the time of a step goes."""

import time
from collections.abc import Iterator
from contextlib import contextmanager


class Stopwatch:
    """Milliseconds by stage since the last `reset`; a stage may run several times."""

    def __init__(self) -> None:
        self.stage_ms: dict[str, float] = {}

    def reset(self) -> None:
        """Begin a new step."""
        self.stage_ms = {}

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Add the time that the block takes."""
        begun = time.perf_counter()
        try:
            yield
        finally:
            self.stage_ms[stage] = self.stage_ms.get(stage, 0.0) + 1e3 * (time.perf_counter() - begun)
