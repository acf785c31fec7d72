"""Real RGB-D frames, which are no part of the repository: tests that read them skip where they are absent."""

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
REAL_FRAMES = Path(os.environ.get("NEUSE_REAL_FRAMES", ROOT.parent / "shared" / "real_frames"))

needs_real_frames = pytest.mark.skipif(
    not (REAL_FRAMES / "frames.json").is_file(),
    reason=f"no real frames in {REAL_FRAMES}; set NEUSE_REAL_FRAMES to their folder",
)
