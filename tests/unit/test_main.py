"""The command line of the library."""

import subprocess
import sys

import pytest

from neuse import __main__ as command_line
from neuse.embedding import train


def test_arguments_go_to_the_command_and_its_exit_code_comes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[list[str]] = []
    monkeypatch.setattr(train, "main", lambda arguments: given.append(arguments) or 3)
    assert command_line.main(["train", "--category", "kettle", "--resume"]) == 3
    assert given == [["--category", "kettle", "--resume"]]


def test_unknown_command_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        command_line.main(["learn"])
    assert "choose from" in capsys.readouterr().err


def test_commands_say_what_they_do(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        command_line.main(["train", "--help"])
    assert "neuse train --category kettle --meshes DIR" in capsys.readouterr().out


def test_expected_error_is_one_line() -> None:
    call = [sys.executable, "-m", "neuse", "train", "--category", "kettle", "--meshes", "/nowhere"]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert done.stderr.startswith("neuse train: /nowhere is not a directory")
