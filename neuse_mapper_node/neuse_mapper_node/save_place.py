"""Where the map is kept when the node ends."""

import tempfile
from pathlib import Path

from neuse.errors import MapFileError

BEFORE_RESET = ".before-reset"  # beside it: the map of before the clock went back


def check_place(path: str) -> None:
    """Refuse a place that could not be written to at the end, when the map would be lost.

    Raises:
        MapFileError: a folder, or a file in a folder that does not exist or cannot be written to.
    """
    place = Path(path).absolute()
    if place.is_dir():
        raise MapFileError(
            f"save_path {path!r} is a folder; give the path of a file, such as {path}/room.map"
        )
    try:
        with tempfile.TemporaryFile(dir=place.parent):
            pass
    except (OSError, ValueError) as error:  # the second for names that the system does not take
        reason = "does not exist; make it" if not place.parent.is_dir() else f"cannot be written to ({error})"
        raise MapFileError(
            f"save_path {path!r}: folder {place.parent} {reason}, or choose another path"
        ) from error
