"""Which embeddings a node works with."""

from collections.abc import Sequence

from neuse.embedding.embedding import Embedding, load_embedding

SHIPPED = ("bottle", "bowl", "box", "mug")
MEANING = "shipped categories or .safetensors files, one a category"


def load_embeddings(names: Sequence[str], device: str) -> dict[str, Embedding]:
    """Embeddings by category, on a device (see neuse.embedding.devices).

    Raises:
        WeightsError: a name that is no shipped category and no readable weights file.
        InputError: `device`, this machine has none of this name.
    """
    embeddings = [load_embedding(name, device) for name in names]
    return {embedding.category: embedding for embedding in embeddings}
