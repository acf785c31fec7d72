"""NeuSE-ROS: object SLAM that survives a changing world, without ROS.

The names below are loaded when first used, so that tools which need no network start without torch.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from neuse.embedding.code import Code
    from neuse.embedding.embedding import Embedding, load_embedding
    from neuse.slam.registration import Alignment, align

__all__ = ["Alignment", "Code", "Embedding", "align", "load_embedding"]

_HOMES = {
    "Code": "neuse.embedding.code",
    "Embedding": "neuse.embedding.embedding",
    "load_embedding": "neuse.embedding.embedding",
    "Alignment": "neuse.slam.registration",
    "align": "neuse.slam.registration",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'neuse' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
