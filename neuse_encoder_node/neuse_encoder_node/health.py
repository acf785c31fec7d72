"""What a node tells /diagnostics: counters of refused input, times of its stages, frames a second."""

import threading
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import contextmanager

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from std_msgs.msg import Header

TOLD = ("frames", "objects", "edges")
DROPPED = "dropped_frame"  # the reason of what came faster than it could be worked on


class Health:
    """Thread-safe account of one node. Times are wall clock; they never influence results."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._tallies: Counter[str] = Counter()
        self._refused: Counter[str] = Counter()
        self._spent_s: defaultdict[str, float] = defaultdict(float)
        self._runs: Counter[str] = Counter()
        self._fault = ""
        self._reported_refused: Counter[str] = Counter()
        self._reported_frames = 0
        self._reported_at_s = time.perf_counter()

    def tally(self, name: str, amount: int = 1) -> None:
        """Count what went well; `frames` gives the rate."""
        with self._lock:
            self._tallies[name] += amount

    def state(self, name: str, value: int) -> None:
        """Say how many of something there are now."""
        with self._lock:
            self._tallies[name] = value

    def refuse(self, reason: str, amount: int = 1) -> None:
        """Count input that was not used, by the `reason` of the library's errors."""
        with self._lock:
            self._refused[reason] += amount

    def fail(self, fault: str) -> None:
        """Say what keeps the node from working; an empty text takes it back."""
        self._fault = fault

    def add_time(self, stage: str, seconds: float, runs: int = 1) -> None:
        """Add the time of a stage that ran `runs` times."""
        with self._lock:
            self._spent_s[stage] += seconds
            self._runs[stage] += runs

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Add the time that the block takes."""
        start_s = time.perf_counter()
        try:
            yield
        finally:
            self.add_time(stage, time.perf_counter() - start_s)

    def report(self, node_name: str, header: Header) -> DiagnosticArray:
        """The account since the start, and rate and faults since the last report, as a message."""
        with self._lock:
            values, recent = self._values(), sorted(self._refused - self._reported_refused)
            self._reported_refused = Counter(self._refused)
            self._reported_frames, self._reported_at_s = self._tallies["frames"], time.perf_counter()
        status = DiagnosticStatus(name=node_name, hardware_id=node_name)
        status.level, status.message = self._verdict(recent)
        status.values = [KeyValue(key=key, value=value) for key, value in values.items()]
        return DiagnosticArray(header=header, status=[status])

    def summary(self) -> str:
        """One line since the start: what was counted, what was dropped and what else was refused."""
        with self._lock:
            counts, dropped = {**dict.fromkeys(TOLD, 0), **self._tallies}, self._refused[DROPPED]
            others = self._refused.total() - dropped
        counted = [f"{count} {name.replace('_', ' ')}" for name, count in counts.items()]
        return ", ".join([*counted, f"{dropped} dropped", f"{others} refused"])

    def _values(self) -> dict[str, str]:
        elapsed_s = max(time.perf_counter() - self._reported_at_s, 1e-9)
        rate = (self._tallies["frames"] - self._reported_frames) / elapsed_s
        means_ms = {stage: 1e3 * self._spent_s[stage] / runs for stage, runs in self._runs.items() if runs}
        return {
            **{name: str(count) for name, count in sorted(self._tallies.items())},
            **{reason: str(count) for reason, count in sorted(self._refused.items())},
            **{f"stage_ms/{stage}": f"{mean:.3f}" for stage, mean in sorted(means_ms.items())},
            "fps": f"{rate:.2f}",
        }

    def _verdict(self, recent: list[str]) -> tuple[bytes, str]:
        if self._fault:
            return DiagnosticStatus.ERROR, self._fault
        if recent:
            return DiagnosticStatus.WARN, "refused input: " + ", ".join(recent)
        return DiagnosticStatus.OK, "running"
