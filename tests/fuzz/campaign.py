"""Feed malformed inputs to every reader of this repository, and keep the least input that one fails on.

A reader must refuse an input with an error of neuse/errors.py that says what is wrong, or take it and come
out sound. Anything else is a failure: another exception, more than a second of processor time, numbers that
are none, or memory beyond the limit. Failing inputs lie in OUT/examples, are made as small as possible, and
are tried first in the next run; OUT/<target>.txt tells of each.
"""

import argparse
import resource
import time
import traceback
import warnings
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis.database import DirectoryBasedExampleDatabase, ExampleDatabase

from .target import HARMLESS, REFUSED, Target
from .targets import all_targets

MEMORY_BYTES = 6 * 1024**3  # of address space; an input that asks for more is a failure


@dataclass
class Result:
    """What came of one target."""

    counts: Counter[str] = field(default_factory=Counter)
    seconds: float = 0.0
    failure: str = ""


def fuzz(target: Target, inputs: int, number: int, database: ExampleDatabase | None = None) -> Result:
    """Feed a target; after a failure the least failing input is sought, and the rest is left out."""
    result = Result()

    @seed(number)
    @settings(
        max_examples=inputs,
        deadline=None,
        database=database,
        phases=[Phase.reuse, Phase.generate, Phase.shrink],
        suppress_health_check=list(HealthCheck),
        report_multiple_bugs=False,
    )
    @given(target.spoiled)
    def judge(spoiled: object) -> None:
        result.counts[target.judge(spoiled)] += 1

    started_s = time.process_time()
    try:
        judge()
    except Exception:  # whatever a reader lets out is what we are here for
        result.failure = traceback.format_exc()
    result.seconds = time.process_time() - started_s
    return result


def main(argv: list[str] | None = None) -> int:
    """The command; 1 where a target failed."""
    args = parser().parse_args(argv)
    warnings.simplefilter("ignore")  # of overflows; what comes out is looked at
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    files = args.out / "files"
    files.mkdir(parents=True, exist_ok=True)
    targets = [target for target in all_targets(files) if args.only in target.name]
    database = DirectoryBasedExampleDatabase(args.out / "examples")
    results: dict[str, Result] = {}
    for target in targets:
        results[target.name] = fuzz(target, -(-args.inputs // len(targets)), args.seed, database)
        print(_line(target.name, results[target.name]), flush=True)
        if results[target.name].failure:
            told = args.out / f"{target.name.replace('/', '_')}.txt"
            told.write_text(results[target.name].failure)
            print(f"    {told}", flush=True)
    print(_line("all", _sum(results)))
    return int(any(result.failure for result in results.values()))


def _line(name: str, result: Result) -> str:
    refused, harmless = result.counts[REFUSED], result.counts[HARMLESS]
    verdict = "FAILED" if result.failure else "ok"
    return f"{name:<28}{refused:>8} refused {harmless:>8} harmless {result.seconds:>7.0f} s  {verdict}"


def _sum(results: dict[str, Result]) -> Result:
    total = Result(failure="".join(result.failure for result in results.values()))
    for result in results.values():
        total.counts += result.counts
        total.seconds += result.seconds
    return total


def parser() -> argparse.ArgumentParser:
    """Arguments of the command."""
    made = argparse.ArgumentParser(prog="tests/fuzz", description=__doc__)
    made.add_argument("--inputs", type=int, default=100_000, help="of all targets together (100000)")
    made.add_argument("--seed", type=int, default=0, help="other seeds draw other inputs (0)")
    made.add_argument("--only", default="", metavar="NAME", help="targets with this in their names (all)")
    made.add_argument("--out", type=Path, default=Path("out/fuzz"), metavar="DIR", help="for what failed")
    return made
