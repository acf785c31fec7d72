import argparse
import os
import signal

import pytest

from neuse.errors import BagError, ParamError
from neuse_bags.cli import BAD_INPUT, INTERRUPTED, check_at_least, command_parser, run_command, stop_on_signal


@pytest.fixture(autouse=True)
def keep_signal_handlers():
    before = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, before)


def _fail(error: BaseException):
    def action(args: argparse.Namespace) -> None:
        raise error

    return action


def test_expected_error_is_one_line_and_exit_code_two(capsys) -> None:
    assert run_command(command_parser("play", ""), _fail(BagError("no such bag")), []) == BAD_INPUT
    assert capsys.readouterr().err == "neuse_bags play: no such bag\n"


def test_place_that_cannot_be_written_is_one_line(capsys) -> None:
    error = FileExistsError(17, "File exists", "some/file")
    assert run_command(command_parser("run", ""), _fail(error), []) == BAD_INPUT
    assert capsys.readouterr().err == "neuse_bags run: some/file: File exists; choose another place\n"


@pytest.mark.parametrize("value", [0.9, -1.0, float("nan"), float("inf")])
def test_number_out_of_bounds_is_refused_by_its_option(value: float) -> None:
    with pytest.raises(ParamError, match=r"--frames .* must be at least 1 and finite; all"):
        check_at_least("--frames", value, 1, "all")
    check_at_least("--frames", 1, 1, "all")


def test_interruption_is_told_by_the_exit_code() -> None:
    assert run_command(command_parser("play", ""), _fail(KeyboardInterrupt()), []) == INTERRUPTED


def test_unexpected_error_is_not_hidden() -> None:
    with pytest.raises(ZeroDivisionError):
        run_command(command_parser("play", ""), _fail(ZeroDivisionError()), [])


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_first_signal_asks_and_the_second_interrupts(number: signal.Signals) -> None:
    with stop_on_signal() as stop:
        os.kill(os.getpid(), number)
        assert stop.is_set()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), number)


def test_handlers_are_given_back() -> None:
    before = signal.getsignal(signal.SIGINT)
    with stop_on_signal():
        assert signal.getsignal(signal.SIGINT) is not before
    assert signal.getsignal(signal.SIGINT) is before


def test_missing_file_is_told_to_be_looked_for(capsys) -> None:
    error = FileNotFoundError(2, "No such file or directory", "some/file")
    assert run_command(command_parser("run", ""), _fail(error), []) == BAD_INPUT
    assert capsys.readouterr().err.endswith("No such file or directory; check the name of the file\n")
