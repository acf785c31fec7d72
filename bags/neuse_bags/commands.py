"""Entry points of all commands: `commands.play` runs neuse_bags.play, and so on."""

from collections.abc import Callable
from functools import partial

from neuse_encoder_node.start import start


def __getattr__(command: str) -> Callable[[], int | None]:
    return partial(start, f"neuse_bags.{command}")
