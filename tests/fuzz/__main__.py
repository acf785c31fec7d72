"""python tests/fuzz --inputs 100000"""

import sys
from pathlib import Path

TESTS = Path(__file__).absolute().parent.parent
sys.path[:0] = [str(TESTS), str(TESTS / "unit"), str(TESTS.parent)]

from fuzz.campaign import main  # noqa: E402

sys.exit(main())
