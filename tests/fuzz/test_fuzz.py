"""A few malformed inputs for every reader; `python tests/fuzz` feeds as many as wanted."""

import pytest
import rclpy

from .campaign import Result, fuzz
from .target import HARMLESS, REFUSED
from .targets import all_targets

pytestmark = pytest.mark.slow

INPUTS = 15  # of each reader


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Result]:
    targets = all_targets(tmp_path_factory.mktemp("fuzz"))
    yield {target.name: fuzz(target, INPUTS, number=0) for target in targets}
    rclpy.try_shutdown()


def test_no_reader_fails_on_malformed_input(results: dict[str, Result]):
    failures = [f"{name}\n{result.failure}" for name, result in results.items() if result.failure]
    assert not failures, "\n\n".join(failures)


def test_most_malformed_inputs_are_refused(results: dict[str, Result]):
    refused = sum(result.counts[REFUSED] for result in results.values())
    harmless = sum(result.counts[HARMLESS] for result in results.values())
    assert refused + harmless >= 0.9 * INPUTS * len(results)
    assert refused > harmless
