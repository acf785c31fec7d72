"""Map files: objects with their views, keyframes with what they saw, and changes, in one .npz without pickle.

A file is written whole or not at all, and checked before it is believed: sizes before memory is taken for
them, then the version, then every value.
"""

import io
import json
import os
import zipfile
import zlib
from contextlib import suppress
from pathlib import Path

import numpy as np

from neuse.errors import MapFileError
from neuse.mapping.archive import read_arrays
from neuse.mapping.map_layout import from_arrays, to_arrays
from neuse.mapping.stored_map import StoredMap

FORMAT = "neuse-map"
VERSION = 3
_UNREADABLE = (
    OSError, EOFError, ValueError, KeyError, AttributeError, RuntimeError, SyntaxError, MemoryError,
    zipfile.BadZipFile, zlib.error,
)  # fmt: skip


def save_map(path: Path, stored: StoredMap) -> None:
    """Write a map file; what was there before stays until the new file is complete.

    Raises:
        MapFileError: the place cannot be written.
    """
    if not path.name or (path.exists() and not path.is_file()):
        raise MapFileError(f"cannot write the map to {str(path)!r}: no name of a file")
    header, arrays = to_arrays(stored)
    header |= {"format": FORMAT, "version": VERSION}
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    content = io.BytesIO()
    np.savez_compressed(content, **arrays)  # type: ignore[arg-type]
    try:
        _write_whole(path, content.getbuffer())
    except (OSError, ValueError) as error:  # the second for names that the system does not take
        raise MapFileError(f"cannot write the map to {path}: {error}") from error


def load_map(path: Path) -> StoredMap:
    """Read a map file.

    Raises:
        MapFileError: the file is missing, damaged, not a map, or of another version.
    """
    try:
        arrays = read_arrays(path)
        header = json.loads(arrays.pop("header").tobytes())
    except FileNotFoundError as error:
        raise MapFileError(f"there is no map file {path}") from error
    except _UNREADABLE as error:
        raise MapFileError(f"{path} is damaged or no map file: {error}") from error
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise MapFileError(f"{path} is no map file of this program")
    if header.get("version") != VERSION:
        raise MapFileError(
            f"{path} is a map of version {header.get('version')}; this program reads {VERSION}"
        )
    try:
        return from_arrays(header, arrays)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise MapFileError(f"{path} is damaged: {error!r}") from error


def _write_whole(path: Path, content: memoryview) -> None:
    """Beside the place first, then onto the disk, and only then into the place."""
    unfinished = path.with_name(path.name + ".part")
    try:
        with open(unfinished, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(unfinished, path)
    except (OSError, ValueError):
        with suppress(OSError, ValueError):
            unfinished.unlink(missing_ok=True)
        raise
