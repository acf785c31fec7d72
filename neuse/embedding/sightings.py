"""Test scenes through the front end in use: two objects of each category from several poses."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from neuse.embedding.code import Code
from neuse.embedding.embedding import Embedding
from neuse.embedding.layouts import reach_m, rest, room
from neuse.embedding.observe import Observer, back_project
from neuse.embedding.views import BESIDE_LENS_M, CAMERA, draw_camera, handle_share
from neuse.geometry import Array, inverse, transform_points
from neuse.records import Instance, RgbdFrame
from neuse.simulation.camera import RayScene, Rendering, Solid
from neuse.simulation.sensor import SensorFaults, apply_faults
from neuse.simulation.shapes import Shape

PER_CATEGORY = 2


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
class Truth:
    """One object in one view.

    visible: share of its outline that neither others nor the image border hide.
    handle: share of the seen points that are on the handle.
    """

    scene: int
    view: int
    shape: Shape
    T_camera_object: Array
    visible: float
    handle: float

    @property
    def range_m(self) -> float:
        """Distance of the object from the camera."""
        return float(np.linalg.norm(self.T_camera_object[:3, 3]))


@dataclass(frozen=True)
class Sighting(Truth):
    """What the front end made of it."""

    code: Code


@dataclass(frozen=True)
class Arrangement:
    """Objects around the origin of the world, instance i + 1 each, and each by itself."""

    shapes: Sequence[Shape]
    places: Sequence[Array]  # T_world_object
    scene: RayScene
    alone: Sequence[RayScene]


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
            for category in shapes
            for i in range(PER_CATEGORY)
        ]
        arrangement = _arrange(chosen, rng)
        for range_m in sorted({condition.range_m for condition in conditions}):
            own = [condition for condition in conditions if condition.range_m == range_m]
            found: dict[str, list[Sighting]] = {condition.name: [] for condition in own}
            for view in range(n_views):
                T_camera_world = _draw_pose(range_m, rng)
                rendering = CAMERA.render(arrangement.scene, inverse(T_camera_world))
                truths = _truths(arrangement, T_camera_world, rendering, (index, view))
                distance_m = float(np.linalg.norm(T_camera_world[:3, 3]))
                for condition in own:
                    faults = condition.faults(distance_m)
                    found[condition.name] += _sightings(observer, faults, rendering, truths, rng)
            yield from ((condition, found[condition.name]) for condition in own)


def _arrange(chosen: Sequence[Shape], rng: np.random.Generator) -> Arrangement:
    """Close enough to hide each other."""
    places = []
    for i, shape in enumerate(chosen):
        T = rest(shape, rng, anyhow=0.0)
        angle = 2 * np.pi * (i + rng.uniform(-0.2, 0.2)) / len(chosen)
        distance = 1.2 * reach_m(shape, T) + rng.uniform(0.03, 0.1)
        T[:2, 3] = distance * np.array([np.cos(angle), np.sin(angle)])
        places.append(T)
    solids = [Solid(s.mesh, T, i + 1) for i, (s, T) in enumerate(zip(chosen, places, strict=True))]
    scene = RayScene([*solids, *room(rng, True)])
    return Arrangement(chosen, places, scene, [RayScene([solid]) for solid in solids])


def _draw_pose(range_m: tuple[float, float], rng: np.random.Generator) -> Array:
    """T_camera_world at a log-uniform range."""
    distance_m = float(np.exp(rng.uniform(*np.log(range_m))))
    elevation = np.radians(rng.triangular(4.0, 20.0, 85.0))
    return draw_camera(rng.uniform(0, 2 * np.pi), elevation, distance_m, rng)


def _truths(
    arrangement: Arrangement, T_camera_world: Array, rendering: Rendering, index: tuple[int, int]
) -> list[Truth]:
    """What is true of each object in this view."""
    n_pixels = np.bincount(rendering.label.ravel(), minlength=len(arrangement.shapes) + 1)
    truths = []
    for i, (shape, place) in enumerate(zip(arrangement.shapes, arrangement.places, strict=True)):
        T_camera_object = T_camera_world @ place
        outline_px = max(_outline_px(arrangement.alone[i], shape, T_camera_object, place), 1)
        handle = _handle(rendering, i + 1, shape, T_camera_object)
        truths.append(Truth(*index, shape, T_camera_object, min(n_pixels[i + 1] / outline_px, 1), handle))
    return truths


def _sightings(
    observer: Observer,
    faults: SensorFaults,
    rendering: Rendering,
    truths: Sequence[Truth],
    rng: np.random.Generator,
) -> list[Sighting]:
    """What the front end makes of one view through one sensor."""
    depth_m, mask = apply_faults(rendering.depth_m, rendering.label, faults, rng)
    labels = [label for label in np.unique(mask).tolist() if label]
    instances = tuple(Instance(label, truths[label - 1].shape.category) for label in labels)
    observed = observer.observe(RgbdFrame(0, depth_m, mask, instances, CAMERA.intrinsics))
    return [Sighting(**vars(truths[seen.label - 1]), code=seen.code) for seen in observed.observations]


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
