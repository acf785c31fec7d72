"""Test scenes through the front end in use: two mugs and two bottles from several poses."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from neuse.embedding.code import Code
from neuse.embedding.embedding import Embedding
from neuse.embedding.observe import Observer, back_project
from neuse.embedding.views import CAMERA, draw_camera, handle_share, reach_m, rest, room
from neuse.geometry import Array, inverse, transform_points
from neuse.records import Instance, RgbdFrame
from neuse.simulation.camera import RayScene, Rendering, Solid
from neuse.simulation.sensor import SensorFaults, apply_faults
from neuse.simulation.shapes import Shape

PER_CATEGORY = 2
CATEGORIES = ("mug", "bottle")
BESIDE_LENS_M = 0.05


@dataclass(frozen=True)
class Condition:
    """A sensor to evaluate under: noise constant, or growing with range squared, and range of the camera."""

    name: str
    noise_m: float
    growing: bool = False
    mask_faults: bool = False
    range_m: tuple[float, float] = (0.3, 5.0)

    def faults(self, range_m: float) -> SensorFaults:
        """The sensor at this range."""
        at_1m = self.noise_m if self.growing else min(self.noise_m / range_m**2, 0.1)
        if not self.mask_faults:
            return SensorFaults(noise_m_at_1m=at_1m)
        return SensorFaults(
            noise_m_at_1m=at_1m, erosion_px=2, dilation_px=1, cut_rate=0.2, merge_rate=0.1, miss_rate=0.03
        )


@dataclass(frozen=True)
class Sighting:
    """One object in one view.

    visible: share of its outline that neither others nor the image border hide.
    handle: share of the seen points that are on the handle.
    """

    scene: int
    view: int
    shape: Shape
    code: Code
    T_camera_object: Array
    visible: float
    handle: float

    @property
    def range_m(self) -> float:
        """Distance of the object from the camera."""
        return float(np.linalg.norm(self.T_camera_object[:3, 3]))


def draw_sightings(
    shapes: Mapping[str, Sequence[Shape]],
    embeddings: Mapping[str, Embedding],
    conditions: Sequence[Condition],
    n_scenes: int,
    n_views: int,
    rng: np.random.Generator,
) -> Iterator[tuple[Condition, list[Sighting]]]:
    """All sightings of scene after scene, by condition; conditions of one range share the poses."""
    observer = Observer(embeddings=embeddings)
    for index in range(n_scenes):
        chosen = [
            shapes[category][(PER_CATEGORY * index + i) % len(shapes[category])]
            for category in CATEGORIES
            for i in range(PER_CATEGORY)
        ]
        scene, alone, places = _arrange(chosen, rng)
        for range_m in sorted({condition.range_m for condition in conditions}):
            own = [condition for condition in conditions if condition.range_m == range_m]
            found: dict[str, list[Sighting]] = {condition.name: [] for condition in own}
            for view in range(n_views):
                sightings = _view(observer, scene, alone, places, chosen, own, (index, view), rng)
                for name, seen in sightings.items():
                    found[name] += seen
            yield from ((condition, found[condition.name]) for condition in own)


def _arrange(
    chosen: Sequence[Shape], rng: np.random.Generator
) -> tuple[RayScene, list[RayScene], list[Array]]:
    """Objects around the origin, close enough to hide each other."""
    places = []
    for i, shape in enumerate(chosen):
        T = rest(shape, rng, anyhow=0.0)
        angle = 2 * np.pi * (i + rng.uniform(-0.2, 0.2)) / len(chosen)
        distance = 1.2 * reach_m(shape, T) + rng.uniform(0.03, 0.1)
        T[:2, 3] = distance * np.array([np.cos(angle), np.sin(angle)])
        places.append(T)
    solids = [Solid(s.mesh, T, i + 1) for i, (s, T) in enumerate(zip(chosen, places, strict=True))]
    return RayScene([*solids, *room(rng, True)]), [RayScene([solid]) for solid in solids], places


def _view(
    observer: Observer,
    scene: RayScene,
    alone: Sequence[RayScene],
    places: Sequence[Array],
    chosen: Sequence[Shape],
    conditions: Sequence[Condition],
    index: tuple[int, int],
    rng: np.random.Generator,
) -> dict[str, list[Sighting]]:
    """Sightings of one pose, by condition."""
    range_m = float(np.exp(rng.uniform(*np.log(conditions[0].range_m))))
    elevation = np.radians(rng.triangular(4.0, 20.0, 85.0))
    T_camera_world = draw_camera(rng.uniform(0, 2 * np.pi), elevation, range_m, rng)
    rendering = CAMERA.render(scene, inverse(T_camera_world))
    n_pixels = np.bincount(rendering.label.ravel(), minlength=len(chosen) + 1)
    visible = [
        min(n_pixels[i + 1] / max(_outline_px(alone[i], shape, T_camera_world @ places[i], places[i]), 1), 1)
        for i, shape in enumerate(chosen)
    ]
    sightings = {}
    for condition in conditions:
        depth_m, mask = apply_faults(rendering.depth_m, rendering.label, condition.faults(range_m), rng)
        labels = [label for label in np.unique(mask).tolist() if label]
        instances = tuple(Instance(label, chosen[label - 1].category) for label in labels)
        observed = observer.observe(RgbdFrame(0, depth_m, mask, instances, CAMERA.intrinsics))
        sightings[condition.name] = [
            Sighting(
                *index,
                chosen[seen.label - 1],
                seen.code,
                T_camera_world @ places[seen.label - 1],
                visible[seen.label - 1],
                _handle(
                    rendering, seen.label, chosen[seen.label - 1], T_camera_world @ places[seen.label - 1]
                ),
            )
            for seen in observed.observations
        ]
    return sightings


def _outline_px(alone: RayScene, shape: Shape, T_camera_object: Array, T_world_object: Array) -> float:
    """Pixels of the whole object, hidden or beyond the border too; of one beside the lens, no number."""
    vertices = transform_points(T_camera_object, shape.mesh.vertices)
    if vertices[:, 2].min() < BESIDE_LENS_M:
        return np.inf
    return CAMERA.silhouette_px(alone, T_world_object @ inverse(T_camera_object), vertices)


def _handle(rendering: Rendering, label: int, shape: Shape, T_camera_object: Array) -> float:
    pixels = np.flatnonzero(rendering.label == label)
    points = back_project(rendering.depth_m, CAMERA.intrinsics, pixels, np.inf)
    return handle_share(shape, transform_points(inverse(T_camera_object), points))
