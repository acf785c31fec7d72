"""Chunks of an MCAP file, checked before they are unpacked: a few kilobytes may claim or hide gigabytes."""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

from backports import zstd
from lz4.frame import LZ4FrameDecompressor

from neuse.errors import BagError

LIMIT_BYTES = 2**30  # of a chunk unpacked; writers make them of one to ten megabytes
_MAGIC = b"\x89MCAP0\r\n"
_CHUNK = 6


class Chunk(NamedTuple):
    """What a chunk says of itself, and where its packed bytes lie."""

    unpacked_bytes: int
    compression: bytes
    packed_bytes: int
    offset: int


def check_chunks(path: Path, limit_bytes: int = LIMIT_BYTES) -> None:
    """Look through a file, or a folder of files, without unpacking what tells its own size.

    Raises:
        BagError: a chunk is larger than the limit, or than it says.
        struct.error: the file ends within a chunk.
    """
    for file in sorted(path.glob("*.mcap")) if path.is_dir() else [path]:
        with file.open("rb") as stream:
            for chunk in _chunks(stream) if stream.read(len(_MAGIC)) == _MAGIC else ():
                if chunk.unpacked_bytes > limit_bytes or not _is_true(chunk, stream):
                    told = f"{file} has a chunk that unpacks to more than {limit_bytes / 1e9:.3g} GB"
                    raise BagError(f"{told}, or than it says; write it again in smaller chunks")


def _chunks(stream: BinaryIO) -> Iterator[Chunk]:
    """The chunks, found by going from record to record."""
    while len(head := stream.read(9)) == 9:
        kind, length = struct.unpack("<BQ", head)
        end = stream.tell() + length
        if kind == _CHUNK:
            _, _, unpacked_bytes, _, n = struct.unpack("<QQQII", stream.read(32))
            compression = stream.read(min(n, 16))
            (packed_bytes,) = struct.unpack("<Q", stream.read(8))
            yield Chunk(unpacked_bytes, compression, packed_bytes, stream.tell())
        if end >= 2**63:
            return  # the parser says what is wrong with it
        stream.seek(end)


def _is_true(chunk: Chunk, stream: BinaryIO) -> bool:
    """Whether the packed bytes hold no more than the chunk says; never unpacks more than that."""
    stream.seek(chunk.offset)
    if chunk.compression == b"zstd":
        told = _size_in_frame(stream.read(min(chunk.packed_bytes, 18)))
        if told is not None:
            return told <= chunk.unpacked_bytes
        unpack = zstd.ZstdDecompressor().decompress
    elif chunk.compression == b"lz4":
        unpack = LZ4FrameDecompressor().decompress
    else:
        return True
    stream.seek(chunk.offset)
    return len(unpack(stream.read(chunk.packed_bytes), chunk.unpacked_bytes + 1)) <= chunk.unpacked_bytes


def _size_in_frame(head: bytes) -> int | None:
    """Size that a zstd frame gives, None where it does not."""
    try:
        return zstd.get_frame_info(head).decompressed_size
    except zstd.ZstdError:
        return None
