"""Arrays to which rows are appended one by one."""

from typing import Any

import numpy as np

from neuse.geometry import Array


class GrowingArray:
    """Rows of one shape; to append one takes constant time on average."""

    def __init__(self, shape: tuple[int, ...], dtype: Any = np.float64) -> None:
        self._buffer, self._length = np.empty((16, *shape), dtype), 0

    def __len__(self) -> int:
        return self._length

    @property
    def rows(self) -> Array:
        """(n, ...) all rows so far, as a view to read and to change."""
        return self._buffer[: self._length]

    def append(self, row: Any) -> None:
        """One more row."""
        self.extend(np.asarray(row)[None])

    def extend(self, rows: np.ndarray) -> None:
        """More rows, (m, ...)."""
        needed = self._length + len(rows)
        if needed > len(self._buffer):
            buffer = np.empty((2 * needed, *self._buffer.shape[1:]), self._buffer.dtype)
            buffer[: self._length] = self.rows
            self._buffer = buffer
        self._buffer[self._length : needed] = rows
        self._length = needed
