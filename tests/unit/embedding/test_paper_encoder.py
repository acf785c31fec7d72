import torch
from scipy.spatial.transform import Rotation

from neuse.embedding.embedding import Embedding
from neuse.embedding.network import Network, load_network, save_network
from neuse.embedding.paper_encoder import PaperEncoderConfig, edge_vectors
from neuse.simulation.shapes import symmetry_of

CONFIG = PaperEncoderConfig(n_latent=16, n_points=64, n_anchors=32, width=16, n_blocks=2, n_neighbors=6)


def network(category="mug"):
    torch.manual_seed(0)
    return Network(category, symmetry_of(category), CONFIG)


def clouds(n=3):
    torch.manual_seed(1)
    return torch.randn(n, 64, 3, dtype=torch.float64) * torch.tensor([0.5, 0.3, 0.4])


def test_edges_are_the_differences_to_the_nearest_points():
    points = clouds(1)
    edges = edge_vectors(points, 5, 6)
    assert edges.shape == (1, 5, 6, 3, 3)
    for i, anchor in enumerate(points[0, :5]):
        nearest = (points[0] - anchor).norm(dim=-1).argsort()[:6]
        difference = points[0, nearest] - anchor
        expected = [difference, anchor.expand(6, 3), torch.linalg.cross(difference, anchor.expand(6, 3))]
        torch.testing.assert_close(edges[0, i], torch.stack(expected, -1).float())


@torch.no_grad()
def test_encoder_turns_latent_points_with_the_cloud_and_keeps_the_descriptor():
    net, points = network(), clouds()
    encoding = net.encode(points)
    for matrix in Rotation.random(5, random_state=0).as_matrix():
        R = torch.tensor(matrix)
        turned = net.encode(points @ R.T)
        for name in ("z", "frame"):
            expected = R.float() @ getattr(encoding, name)
            assert (getattr(turned, name) - expected).norm() <= 1e-4 * expected.norm()
        torch.testing.assert_close(turned.descriptor, encoding.descriptor, atol=1e-4, rtol=1e-4)


@torch.no_grad()
def test_descriptor_is_the_lengths_of_the_latent_points():
    encoding = network().encode(clouds())
    lengths = encoding.z.norm(dim=1)
    torch.testing.assert_close(encoding.descriptor, lengths / lengths.norm(dim=-1, keepdim=True))


@torch.no_grad()
def test_code_and_decoder_agree_on_the_centre():
    net, points = network(), clouds(1)
    code = Embedding(net).encode([points[0] * 0.1])[0]
    torch.testing.assert_close(torch.tensor(code.center), torch.tensor(code.z).mean(0), atol=1e-6, rtol=0)
    encoding = net.encode(points)
    torch.testing.assert_close(encoding.frame[..., 0], encoding.z.mean(-1))


@torch.no_grad()
def test_code_moves_with_the_cloud():
    embedding, points = Embedding(network()), clouds(1)[0].numpy() * 0.1
    R, t = Rotation.random(random_state=1).as_matrix(), [0.3, -0.2, 1.1]
    code, moved = embedding.encode([points, points @ R.T + t])
    expected = code.z @ R.T + t
    assert abs(moved.z - expected).max() <= 1e-4 * abs(code.z - code.center).max()


def test_latent_points_start_as_wide_as_the_object():
    torch.manual_seed(0)
    net = Network("mug", symmetry_of("mug"), PaperEncoderConfig(n_points=64, n_anchors=64, width=64))
    with torch.no_grad():
        spread = float(net.encode(clouds(8)).z.std(-1).mean())
    assert 0.1 < spread < 1.5


def test_weights_come_back_as_the_same_architecture(tmp_path):
    net = network()
    save_network(net, tmp_path / "mug.safetensors", {})
    loaded = load_network(tmp_path / "mug.safetensors", "mug")
    assert (loaded.architecture, loaded.config) == ("paper", CONFIG)
    with torch.no_grad():
        assert torch.equal(loaded.encode(clouds()).z, net.encode(clouds()).z)
