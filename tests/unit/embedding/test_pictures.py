from neuse.embedding import pictures
from neuse.embedding.pictures import save_curves, save_reconstructions
from neuse.errors import InputError

from .tiny import block_mug, make_network


def is_png(path):
    return path.read_bytes()[:4] == b"\x89PNG"


def test_curves_are_drawn_also_where_a_figure_was_not_known_at_first(tmp_path):
    history = [{"step": 500, "frame": 0.4, "iou": float("nan")}, {"step": 1000, "frame": 0.3, "iou": 0.5}]
    save_curves(history, tmp_path / "curves.png")
    assert is_png(tmp_path / "curves.png")


def test_reconstructions_are_drawn_beside_the_truth(tmp_path, mug_views, monkeypatch):
    decoded = []

    class FakeEmbedding:
        def __init__(self, network):
            pass

        def encode(self, clouds):
            return clouds

        def reconstruct(self, cloud, resolution_m):
            decoded.append(cloud)
            if len(decoded) == 1:
                raise InputError("empty_reconstruction", "nothing")
            return block_mug().mesh

    monkeypatch.setattr(pictures, "Embedding", FakeEmbedding)
    save_reconstructions(make_network("mug"), mug_views, tmp_path / "reconstructions.png")
    assert is_png(tmp_path / "reconstructions.png")
    assert len(decoded) == pictures.N_VIEWS
    assert max(abs(cloud).max() for cloud in decoded) < 0.2  # metres about the partial centre
