import pytest

from neuse import errors
from neuse.errors import InputError, NeuseError


def test_every_error_is_caught_as_a_library_error():
    raised = [value for value in vars(errors).values() if isinstance(value, type)]
    assert len(raised) > 5
    assert all(issubclass(error, NeuseError) for error in raised)


def test_input_error_carries_its_reason():
    error = InputError("range", "7 m is too far")
    assert (error.reason, str(error)) == ("range", "7 m is too far")
    with pytest.raises(ValueError, match="too far"):
        raise error
