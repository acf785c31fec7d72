"""Which embeddings a node works with, as its parameters tell it."""

SHIPPED = ("bottle", "bowl", "box", "mug")
MEANING = "shipped categories or .safetensors files, one a category"
