"""How long things take, by the clock on the wall and by that of the processor."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from neuse.stopwatch import Stopwatch

WARM_UP = 5  # first runs, which allocate and are not counted


@dataclass(frozen=True)
class Times:
    """Milliseconds of many runs of one thing: by the wall, and of all threads of the process together."""

    wall_ms: tuple[float, ...]
    cpu_ms: tuple[float, ...]

    def summary(self) -> dict[str, float]:
        """Median, mean, 95th percentile and worst by the wall; median, mean and worst of the processor."""
        return {
            "median_ms": float(np.median(self.wall_ms)),
            "mean_ms": float(np.mean(self.wall_ms)),
            "p95_ms": float(np.percentile(self.wall_ms, 95)),
            "worst_ms": float(np.max(self.wall_ms)),
            "cpu_median_ms": float(np.median(self.cpu_ms)),
            "cpu_mean_ms": float(np.mean(self.cpu_ms)),
            "cpu_worst_ms": float(np.max(self.cpu_ms)),
            "n": len(self.wall_ms),
        }

    @classmethod
    def of(cls, runs: Sequence[tuple[float, float]]) -> "Times":
        """From (wall, processor) milliseconds of each run."""
        return cls(tuple(wall for wall, _ in runs), tuple(cpu for _, cpu in runs))

    def per(self, count: int) -> "Times":
        """The share of one of `count` things that a run did."""
        return Times(tuple(t / count for t in self.wall_ms), tuple(t / count for t in self.cpu_ms))


class TwoClocks(Stopwatch):
    """A stopwatch that also reads the processor's clock: `cpu_ms` beside `stage_ms`."""

    def __init__(self) -> None:
        super().__init__()
        self.cpu_ms: dict[str, float] = {}

    def reset(self) -> None:
        """Begin a new step."""
        super().reset()
        self.cpu_ms = {}

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Add the time that the block takes."""
        begun = time.process_time()
        with super().timed(stage):
            yield
        self.cpu_ms[stage] = self.cpu_ms.get(stage, 0.0) + 1e3 * (time.process_time() - begun)


def timed_runs(action: Callable[[], object], runs: int) -> Times:
    """Times of so many runs after a few that do not count."""
    return Times.of([timed(action) for _ in range(WARM_UP + runs)][WARM_UP:])


def timed(action: Callable[[], object]) -> tuple[float, float]:
    """(wall, processor) milliseconds of one run."""
    wall, cpu = time.perf_counter(), time.process_time()
    action()
    return 1e3 * (time.perf_counter() - wall), 1e3 * (time.process_time() - cpu)
