import os
import subprocess
import sys
from pathlib import Path

import pytest

from neuse_encoder_node.start import INTERRUPTED

INTERRUPT = "import os, signal; os.kill(os.getpid(), signal.SIGINT)"


def run_module(folder: Path, source: str) -> subprocess.CompletedProcess:
    """Start a module of this source."""
    (folder / "started.py").write_text(source)
    code = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "  # as from a terminal
    code += f"import sys; sys.path.append({str(folder)!r}); from neuse_encoder_node.start import start; "
    code += "sys.exit(start('started'))"
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)


def test_ctrl_c_during_imports_ends_quietly(tmp_path: Path):
    done = run_module(tmp_path, f"{INTERRUPT}\nimport time; time.sleep(30)")
    assert (done.returncode, done.stdout, done.stderr) == (INTERRUPTED, "", "")


def test_ctrl_c_afterwards_is_left_to_the_program(tmp_path: Path):
    done = run_module(
        tmp_path,
        f"def main():\n    try:\n        {INTERRUPT}\n        import time; time.sleep(30)\n"
        "    except KeyboardInterrupt:\n        return 7\n",
    )
    assert done.returncode == 7, done.stderr


def test_what_main_returns_is_the_exit_code(tmp_path: Path):
    assert run_module(tmp_path, "def main():\n    return 3\n").returncode == 3


@pytest.mark.parametrize("command", ["play", "info"])
def test_commands_are_found_by_their_names(command: str):
    from neuse_bags import commands

    assert getattr(commands, command).args == (f"neuse_bags.{command}",)


def test_memory_of_a_frame_is_kept_for_the_next(tmp_path: Path):
    source = """
import resource
def main():
    faults = []
    for _ in range(10):
        images = [bytearray(2**20) for _ in range(8)]
        del images
        faults.append(resource.getrusage(resource.RUSAGE_SELF).ru_minflt)
    return int(faults[-1] - faults[1] > 100)
"""
    assert run_module(tmp_path, source).returncode == 0


def test_products_stay_in_their_thread(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    source = """
import os
def main():
    import numpy as np
    matrix = np.ones((1000, 1000))
    matrix @ matrix
    return len(os.listdir("/proc/self/task"))
"""
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    assert run_module(tmp_path, source).returncode == 1
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    assert run_module(tmp_path, source).returncode == min(2, len(os.sched_getaffinity(0)))
