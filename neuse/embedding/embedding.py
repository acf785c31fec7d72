"""The embedding of one category as users meet it: clouds to codes, codes to meshes."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cache, cached_property
from pathlib import Path

import numpy as np
import torch
import trimesh
from numpy.typing import ArrayLike

from neuse.embedding.code import Code
from neuse.embedding.devices import AUTO, device_named
from neuse.embedding.encoder import Encoder, Encoding
from neuse.embedding.network import MIN_POINTS, UNIT_M, Network, load_network
from neuse.embedding.reconstruction import reconstruct
from neuse.embedding.recording import RecordedEncoder
from neuse.errors import InputError, WeightsError
from neuse.geometry import Array

WEIGHTS = Path(__file__).parent.parent / "weights"
SIGMA_UNITS = np.array([1.0] * 3 + [UNIT_M] * 4)  # of an Encoding's: rad, network units
SIGMA_FLOOR = np.array([1e-3] * 3 + [2e-4] * 4)  # rad, m


def shipped_categories() -> tuple[str, ...]:
    """Categories whose weights come with the library."""
    return tuple(sorted(path.stem for path in WEIGHTS.glob("*.safetensors")))


def load_embedding(name: str | Path, device: str = AUTO) -> "Embedding":
    """The embedding of a shipped category (see `shipped_categories`), or of a weights file.

    Args:
        device: what its network runs on: "auto" (a GPU where there is one), "cpu", "cuda", "cuda:1".
    Raises:
        WeightsError: neither a shipped category nor a readable weights file.
        InputError: `device`, this machine has no such device.
    """
    path = weights_file(name)
    network = load_network(path, None if path == Path(name) else str(name))
    return Embedding(network.to(device_named(device)))


def load_embeddings(names: Iterable[str | Path], device: str = AUTO) -> dict[str, "Embedding"]:
    """Embeddings by category; of two for one category the later counts. Raises as `load_embedding` does."""
    return {embedding.category: embedding for embedding in (load_embedding(name, device) for name in names)}


def weights_file(name: str | Path) -> Path:
    """The file of a shipped category, or the file itself, which need not be there.

    Raises:
        WeightsError: neither a shipped category nor named as a weights file.
    """
    if Path(name).suffix == ".safetensors":
        return Path(name)
    if str(name) not in shipped_categories():
        known = ", ".join(shipped_categories()) or "none"
        raise WeightsError(
            f"no weights for category {str(name)!r}; shipped: {known}; or give a .safetensors file"
        )
    return WEIGHTS / f"{name}.safetensors"


class Embedding:
    """Latent codes of partial clouds of one category, and full shapes of latent codes (NeuSE section III)."""

    def __init__(self, network: Network) -> None:
        self.network = network

    @property
    def category(self) -> str:
        """What the network was trained on."""
        return self.network.category

    @property
    def ambiguous(self) -> bool:
        """Whether a turn about the axis cannot be seen."""
        return self.network.ambiguous

    def encode(self, clouds: Sequence[ArrayLike], share: float = 1.0) -> list[Code]:
        """Codes of partial clouds, all in one forward pass (eq. 4); equivariant to rotations and
        translations.

        Args:
            clouds: (n_i, 3) points, metres, any common frame; background points should have been dropped.
            share: of the points that carry features, in (0, 1]; half of them take about half the time, and
                poses err by a tenth more.
        Returns:
            One code a cloud, in the frame of the clouds.
        Raises:
            InputError: a cloud of another shape, with fewer than 8 points or with points that are not finite;
                a share outside (0, 1].
        """
        if not 0.0 < share <= 1.0:
            raise InputError("share", f"share = {share} of the points must be in (0, 1]")
        if len(clouds) == 0:
            return []
        arrays = [_checked(cloud, index) for index, cloud in enumerate(clouds)]
        centers = np.stack([array.mean(axis=0) for array in arrays])
        batch = np.stack([self._sample(array - c) for array, c in zip(arrays, centers, strict=True)])
        n_anchors = max(1, round(share * self.network.config.n_anchors))
        with torch.inference_mode():
            encoding = self._encoder(torch.from_numpy(batch).to(self.network.device), n_anchors)
        return self._codes(encoding, centers)

    def prepare(self) -> None:
        """Do what the first call of `encode` would do beside its work, so that no frame waits for it."""
        self.encode([np.random.default_rng(0).normal(size=(MIN_POINTS, 3))])

    def reconstruct(self, code: Code, resolution_m: float = 0.0025) -> trimesh.Trimesh:
        """The full shape of a code as a closed mesh, in the frame of the code.

        Raises:
            InputError: the code is of another category or size or decodes to nothing; no positive resolution.
        """
        if code.category != self.category:
            raise InputError("category", f"a {self.category} decoder was given the code of a {code.category}")
        k = self.network.config.n_latent
        if len(code.z) != k:
            raise InputError("code_size", f"the code has {len(code.z)} latent points, the decoder reads {k}")
        if not 0.0 < resolution_m < np.inf:
            raise InputError("resolution", f"resolution_m = {resolution_m} must be positive and finite")
        return reconstruct(self.network, code, resolution_m)

    @cached_property
    def _encoder(self) -> Callable[[torch.Tensor, int], Encoding]:
        encoder = self.network.encoder
        if isinstance(encoder, Encoder) and self.network.device.type == "cpu":
            return RecordedEncoder(encoder)
        return self.network.encode

    def _sample(self, cloud: Array) -> Array:
        """(n_points, 3) in network units, spread evenly over the order of the cloud, then shuffled."""
        n, wanted = len(cloud), self.network.config.n_points
        order = _shuffled(wanted)
        even = np.round(order * ((n - 1) / (wanted - 1))).astype(int) if n > wanted else order % n
        return cloud[even] / UNIT_M

    def _codes(self, encoding: Encoding, centers: Array) -> list[Code]:
        z = encoding.z.mT.double().cpu().numpy() * UNIT_M + centers[:, None]  # (B, k, 3)
        sigmas = torch.exp(encoding.log_sigmas.clamp(-8, 3)) * self.network.sigma_scale
        sigmas_si = np.maximum(sigmas.double().cpu().numpy() * SIGMA_UNITS, SIGMA_FLOOR)
        sigmas_si[:, :3] = np.minimum(sigmas_si[:, :3], np.pi)
        untold = self.network.symmetry.untold
        sigmas_si[:, untold] = np.pi
        along_axis, correlation = _centre_from_ends(sigmas_si[:, 5], sigmas_si[:, 6])
        if 0 in untold:  # from another view the axis may be another one, of another height
            correlation = np.zeros_like(correlation)
        frame_sigmas = np.concatenate([sigmas_si[:, :5], along_axis[:, None]], axis=1)
        descriptors = encoding.descriptor.double().cpu().numpy()
        return [
            Code(self.category, self.ambiguous, *fields)
            for fields in zip(z, descriptors, frame_sigmas, correlation.tolist(), strict=True)
        ]


class LightEmbedding(Embedding):
    """The appendix's light variant: two small codes, one for transforms and solids, one for descriptors."""

    def __init__(self, pose: Network, shape: Network) -> None:
        super().__init__(pose)
        self.shape = Embedding(shape)

    def encode(self, clouds: Sequence[ArrayLike], share: float = 1.0) -> list[Code]:
        """As `Embedding.encode`, with the descriptors of the other network."""
        pairs = zip(super().encode(clouds, share), self.shape.encode(clouds, share), strict=True)
        return [replace(code, descriptor=other.descriptor) for code, other in pairs]


def _centre_from_ends(top: Array, bottom: Array) -> tuple[Array, Array]:
    """Standard deviation (n,) of the centre along the axis, and its correlation with half the height.

    Centre and half height are half the sum and half the difference of the ends, whose errors are independent.
    """
    return np.hypot(top, bottom) / 2, (top**2 - bottom**2) / (top**2 + bottom**2)


@cache
def _shuffled(n: int) -> np.ndarray:
    """A fixed permutation of n."""
    return np.random.default_rng(0).permutation(n)


def _checked(cloud: ArrayLike, index: int) -> Array:
    array = np.asarray(cloud, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError("cloud_shape", f"cloud {index} has shape {array.shape}, expected (n, 3)")
    if len(array) < MIN_POINTS:
        raise InputError(
            "too_few_points", f"cloud {index} has {len(array)} points, at least {MIN_POINTS} needed"
        )
    if not np.isfinite(array).all():
        raise InputError("not_finite", f"cloud {index} has points that are not finite; drop them first")
    return array
