import time
from types import SimpleNamespace

import pytest

from neuse_mapper_node.decoding import Decoding

DECODE_S = 0.01


def mapper_with(n_lagging: int) -> SimpleNamespace:
    """A mapper of which so many shapes lag behind; `decoded` are the times at which they were decoded."""
    decoded: list[float] = []

    def decode_next() -> bool:
        if len(decoded) >= n_lagging:
            return False
        decoded.append(time.monotonic())
        time.sleep(DECODE_S)
        return True

    return SimpleNamespace(decode_next=decode_next, decoded=decoded)


@pytest.mark.parametrize("share", [0.1, 0.5])
def test_decoding_takes_its_share_of_the_time(share: float):
    mapper = mapper_with(1000)
    decoding, end_s = Decoding(mapper, share), time.monotonic() + 0.3
    while time.monotonic() < end_s:
        decoding.go_on()
    assert 1 < len(mapper.decoded) <= 1 + 0.3 * share / DECODE_S


def test_end_of_decoding_is_told_once():
    mapper = mapper_with(2)
    decoding = Decoding(mapper, 1.0)
    told, end_s = [], time.monotonic() + 0.1
    while time.monotonic() < end_s:
        told.append(decoding.go_on())
    assert len(mapper.decoded) == 2
    assert told.count(True) == 1


def test_nothing_is_told_where_nothing_lags():
    decoding = Decoding(mapper_with(0), 1.0)
    assert not any(decoding.go_on() for _ in range(10))
