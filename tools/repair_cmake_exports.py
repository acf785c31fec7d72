"""Point the CMake exports of the ROS message wheels at this interpreter.

The wheels were built in a container: their exported targets name that container's Python and NumPy headers.
Run with the interpreter of the virtual environment; a second run changes nothing.
"""

import re
import sys
import sysconfig
from pathlib import Path

import numpy as np

BUILDER = r"/opt/python/cp3\d+-cp3\d+"
REPLACEMENTS = {
    re.compile(BUILDER + r"/lib/python3\.\d+/site-packages/numpy/_?core/include"): np.get_include(),
    re.compile(BUILDER + r"/include/python3\.\d+"): sysconfig.get_path("include"),
}


def repair(path: Path) -> bool:
    """Rewrite one CMake file; True if it named the build container."""
    text = original = path.read_text()
    for pattern, here in REPLACEMENTS.items():
        text = pattern.sub(here.replace("\\", r"\\"), text)
    if text != original:
        path.write_text(text)
    return text != original


def main() -> None:
    exports = Path(sys.prefix, "share").rglob("*.cmake")
    print(f"repaired {sum([repair(path) for path in exports])} CMake exports of the message wheels")


if __name__ == "__main__":
    main()
