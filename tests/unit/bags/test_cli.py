import argparse
import os
import signal

import pytest

from neuse.errors import BagError
from neuse_bags.cli import BAD_INPUT, INTERRUPTED, command_parser, run_command, stop_on_signal


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
