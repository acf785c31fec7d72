"""Which embeddings a node works with."""

from collections.abc import Sequence

from neuse.embedding.embedding import Embedding, load_embedding

SHIPPED = ("bottle", "bowl", "box", "mug")
MEANING = "shipped categories or .safetensors files, one a category"


def load_embeddings(names: Sequence[str]) -> dict[str, Embedding]:
    """Embeddings by category.

    Raises:
        WeightsError: a name that is no shipped category and no readable weights file.
    """
    return {embedding.category: embedding for embedding in map(load_embedding, names)}
