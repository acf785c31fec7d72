import io
import os
import tracemalloc
import zipfile

import numpy as np
import pytest

from neuse.errors import MapFileError
from neuse.mapping.archive import read_arrays


def member(array=None, shape=None):
    """Bytes of an array; its header may claim another shape."""
    array = np.arange(6.0).reshape(2, 3) if array is None else array
    stream = io.BytesIO()
    header = np.lib.format.header_data_from_array_1_0(array) | ({"shape": shape} if shape else {})
    np.lib.format.write_array_header_1_0(stream, header)
    return stream.getvalue() + array.tobytes()


def archive(path, data, method=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", method) as file:
        file.writestr("array.npy", data)
    return path


@pytest.mark.parametrize("array", [np.eye(3), np.asfortranarray(np.arange(6).reshape(2, 3)), np.zeros(0)])
def test_what_numpy_writes_is_read(tmp_path, array):
    np.savez_compressed(tmp_path / "a.npz", one=array, two=np.uint8([7]))
    found = read_arrays(tmp_path / "a.npz")
    np.testing.assert_array_equal(found["one"], array)
    assert found.keys() == {"one", "two"}


@pytest.mark.parametrize("shape", [(2, 4), (10**12,), (2**40, 2**40), (-2, -3)])
def test_shape_that_does_not_fit_the_data_is_refused(tmp_path, shape):
    with pytest.raises(ValueError, match="has 48 bytes for float64"):
        read_arrays(archive(tmp_path / "a.npz", member(shape=shape)))


def test_header_that_is_no_literal_is_refused(tmp_path):
    data = member().replace(b"'descr': '", b"'descr'{ '")
    with pytest.raises(ValueError, match=r"array\.npy"):
        read_arrays(archive(tmp_path / "a.npz", data))


def test_pickled_objects_are_refused(tmp_path):
    np.savez(tmp_path / "a.npz", evil=np.array([{"a": 1}], dtype=object))
    with pytest.raises(ValueError, match="for object"):
        read_arrays(tmp_path / "a.npz")


def test_unknown_packing_is_refused(tmp_path):
    with pytest.raises(ValueError, match="packed in an unknown way"):
        read_arrays(archive(tmp_path / "a.npz", member(), zipfile.ZIP_LZMA))


def test_file_that_would_unpack_to_too_much_is_refused_before_memory_is_taken(tmp_path):
    path = archive(tmp_path / "a.npz", bytes(2**26))
    assert path.stat().st_size < 2**17
    tracemalloc.start()
    with pytest.raises(MapFileError, match=r"would unpack to 0\.0671 GB"):
        read_arrays(path, limit_bytes=2**25)
    assert tracemalloc.get_traced_memory()[1] < 2**21
    tracemalloc.stop()


def test_pipe_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(MapFileError, match="is no file"):
        read_arrays(tmp_path / "pipe")
