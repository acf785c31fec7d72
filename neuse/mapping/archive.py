"""Archives of arrays (.npz) read with care: nothing is executed, nothing may unpack to more than a limit."""

import io
import math
import zipfile
from pathlib import Path
from tokenize import TokenError

import numpy as np

from neuse.errors import MapFileError

LIMIT_BYTES = 2 * 1024**3  # an hour's map has 20 MB
_KNOWN = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


def read_arrays(path: Path, limit_bytes: int = LIMIT_BYTES) -> dict[str, np.ndarray]:
    """Arrays by name.

    Raises:
        MapFileError: not a file, or one that would unpack to more than the limit.
        ValueError, OSError, zipfile.BadZipFile, zlib.error: damaged, or no archive of arrays.
    """
    if path.exists() and not path.is_file():
        raise MapFileError(f"{path} is no file; give the path of a map file")
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        size_bytes = sum(member.file_size for member in members)
        if size_bytes > limit_bytes:
            told = f"{path} would unpack to {size_bytes / 1e9:.3g} GB"
            raise MapFileError(f"{told}; a map of over {limit_bytes / 1e9:.3g} GB is none")
        return {member.filename.removesuffix(".npy"): _read_array(archive, member) for member in members}


def _read_array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    """One array, whose header must fit the length of its data before memory is taken for it."""
    if member.compress_type not in _KNOWN:
        raise ValueError(f"{member.filename} is packed in an unknown way")
    stream = io.BytesIO(archive.read(member))
    first = np.lib.format.read_magic(stream) == (1, 0)
    read_header = np.lib.format.read_array_header_1_0 if first else np.lib.format.read_array_header_2_0
    try:
        shape, fortran_order, dtype = read_header(stream)
    except TokenError as error:  # of a header that is no Python literal, which numpy lets out
        raise ValueError(f"{member.filename}: {error}") from error
    data = stream.read()
    if dtype.hasobject or min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != len(data):
        raise ValueError(f"{member.filename} has {len(data)} bytes for {dtype} of shape {shape}")
    return np.frombuffer(data, dtype=dtype).reshape(shape, order="F" if fortran_order else "C")
