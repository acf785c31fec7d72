"""Every error that the library raises on purpose; all derive from NeuseError."""


class NeuseError(Exception):
    """Root of the library's errors. The message names the input, its value and what to do."""


class ParamError(NeuseError, ValueError):
    """A parameter has a value outside its range."""


class InputError(NeuseError, ValueError):
    """Data handed to the library cannot be used; `reason` is a short key for counters."""

    def __init__(self, reason: str, message: str) -> None:
        super().__init__(message)
        self.reason = reason


class DegenerateGeometryError(NeuseError, ValueError):
    """The geometry does not determine the answer (too few or collinear points)."""


class SolverError(NeuseError):
    """The pose graph cannot be solved: something in it is not determined, or far from any solution."""


class WeightsError(NeuseError):
    """A weights file is missing, damaged, or made for another category or version."""


class MeshError(NeuseError, ValueError):
    """A mesh cannot be used as an object (open, empty, or of an unreasonable size)."""


class BagError(NeuseError):
    """A bag is missing, truncated, or lacks a topic that is needed."""


class MapFileError(NeuseError):
    """A map file is missing, damaged, or of another version."""
