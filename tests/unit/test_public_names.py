import subprocess
import sys

import pytest

import neuse


@pytest.mark.parametrize("name", neuse.__all__)
def test_public_names_are_there(name):
    assert getattr(neuse, name).__name__ == name


def test_unknown_public_name_is_refused():
    with pytest.raises(AttributeError, match="no attribute 'lode_embedding'"):
        neuse.lode_embedding  # noqa: B018


def test_importing_the_library_does_not_load_torch():
    code = "import neuse, neuse.records, neuse.geometry, sys; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
