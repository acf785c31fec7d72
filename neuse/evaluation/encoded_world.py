"""Encoded worlds: what the front end saw of a simulated world, beside its truth; built once, then cached."""

from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from itertools import islice
from pathlib import Path

from tqdm import tqdm

from neuse.embedding.observe import Observer
from neuse.evaluation.cache import cached
from neuse.evaluation.simulated_truth import TruthCollector
from neuse.evaluation.truth import Truth
from neuse.records import ObservedFrame, OdometrySample
from neuse.simulation.worlds import make_world, simulate

PACKAGE = Path(__file__).parent.parent
SOURCES = (  # what an encoded world depends on
    *("simulation", "embedding", "weights"),
    *("geometry.py", "params.py", "records.py", "symmetry.py"),
)


@dataclass(frozen=True)
class EncodedWorld:
    """A world as the SLAM stage meets it. Estimators read `frames` and `odometry`; `truth` is for scores."""

    preset: str
    seed: int
    frames: tuple[ObservedFrame, ...]
    odometry: tuple[OdometrySample, ...]
    truth: Truth

    @property
    def name(self) -> str:
        """Preset and seed."""
        return f"{self.preset}-{self.seed}"


def encoded_world(preset: str, seed: int, folder: Path, frames: int | None = None) -> EncodedWorld:
    """An encoded world from the folder's cache, where it is put if it is missing or out of date.

    frames: only so many first frames; None for all.
    """
    path = folder / f"{preset}-{seed}-{frames or 'all'}-{fingerprint(SOURCES)}.world.npz"
    return cached(path, EncodedWorld, lambda: encode_world(preset, seed, Observer(), frames))


def encode_world(preset: str, seed: int, observer: Observer, frames: int | None = None) -> EncodedWorld:
    """Simulate and encode a world; the images are not kept."""
    world = make_world(preset, seed)
    total = min(world.frames, frames or world.frames)
    truth, observed, odometry = TruthCollector(), list[ObservedFrame](), list[OdometrySample]()
    simulated_frames = islice(simulate(world), total)
    for simulated in tqdm(simulated_frames, total=total, unit="frame", desc=f"{preset}-{seed}"):
        observed.append(observer.observe(simulated.frame))
        odometry.append(simulated.odometry)
        truth.add(simulated)
    return EncodedWorld(preset, seed, tuple(observed), tuple(odometry), truth.finish())


def fingerprint(sources: Sequence[str]) -> str:
    """Short hash of files and folders of the package: what other sources have made is out of date."""
    digest = sha256()
    for source in sources:
        root = PACKAGE / source
        files = [root] if root.is_file() else sorted([*root.rglob("*.py"), *root.glob("*.safetensors")])
        for file in files:
            digest.update(file.read_bytes())
    return digest.hexdigest()[:12]
