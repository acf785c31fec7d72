"""Bags that claim or hide more than they should."""

import struct
import tracemalloc
from pathlib import Path

import lz4.frame
import pytest
from backports import zstd

from neuse.errors import BagError
from neuse_bags.chunks import check_chunks
from neuse_bags.mcap_file import BagReader

MEBIBYTE = 2**20


def bag_of(path: Path, claimed: int, compression: bytes, packed: bytes) -> Path:
    """A file with one chunk."""
    head = struct.pack("<QQQII", 0, 1, claimed, 0, len(compression)) + compression
    chunk = head + struct.pack("<Q", len(packed)) + packed
    path.write_bytes(b"\x89MCAP0\r\n" + struct.pack("<BQ", 6, len(chunk)) + chunk)
    return path


def streamed(data: bytes) -> bytes:
    """A zstd frame that does not tell its size."""
    packer = zstd.ZstdCompressor()
    return packer.compress(data) + packer.flush()


@pytest.mark.parametrize(
    "pack", [(b"zstd", zstd.compress), (b"zstd", streamed), (b"lz4", lz4.frame.compress)]
)
def test_chunk_that_hides_more_than_it_says_is_refused_before_memory_is_taken(tmp_path: Path, pack) -> None:
    compression, compress = pack
    packed = compress(bytes(64 * MEBIBYTE))
    tracemalloc.start()
    with pytest.raises(BagError, match="more than"):
        check_chunks(bag_of(tmp_path / "a.mcap", MEBIBYTE, compression, packed))
    assert tracemalloc.get_traced_memory()[1] < 4 * MEBIBYTE
    tracemalloc.stop()
    check_chunks(bag_of(tmp_path / "b.mcap", 64 * MEBIBYTE, compression, packed))


def test_chunk_of_absurd_size_is_refused_by_the_reader(tmp_path: Path) -> None:
    path = bag_of(tmp_path / "a.mcap", 10**13, b"zstd", zstd.compress(b"x"))
    with pytest.raises(BagError, match="smaller chunks"):
        BagReader(path)


def test_sound_bag_passes_and_so_does_what_is_no_bag(frames_bag: Path, tmp_path: Path) -> None:
    check_chunks(frames_bag)
    check_chunks(frames_bag.parent)
    (tmp_path / "text.mcap").write_text("no bag")
    check_chunks(tmp_path / "text.mcap")
