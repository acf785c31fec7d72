"""All targets of the fuzzer."""

from pathlib import Path

from .files import file_targets
from .messages import message_targets
from .services import service_targets
from .target import Target


def all_targets(folder: Path) -> tuple[Target, ...]:
    """Messages, files, parameters and services; folder: where spoiled files are written."""
    return (*message_targets(), *file_targets(folder), *service_targets(folder))
