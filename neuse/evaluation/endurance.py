"""Does memory grow? Localisation and mapping for hours of data, as fast as this machine can.

A camera goes round and round a room of tables. What a moving camera adds is the pose graph itself, a keyframe
every few centimetres; a camera that stands adds next to nothing.
"""

import argparse
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from neuse.evaluation.code_worlds import FRAME_NS, ODOMETRY_SIGMAS, make_code_world
from neuse.geometry import Array, exp, inverse, renormalized
from neuse.mapping.mapper import ObjectMapper
from neuse.records import ObservedFrame, OdometrySample
from neuse.slam.slam import ObjectSlam

OBJECTS = 50
SAMPLES, MOST_BETWEEN = 60, 300  # of memory, and frames between them
PAGE_MB = os.sysconf("SC_PAGE_SIZE") / 1e6
FRAMES_AN_HOUR = 3600 * 10**9 // FRAME_NS


@dataclass(frozen=True)
class Endurance:
    """Resident memory (n,) in MB after so many hours of data (n,), and the processor's time."""

    hours: Array
    memory_mb: Array
    processor_s: float

    @property
    def slope_mb_per_hour(self) -> float:
        """Growth over the second half of the run, least squares."""
        half = len(self.hours) // 2
        return float(np.polyfit(self.hours[half:], self.memory_mb[half:], 1)[0])


def endure(frames: int, speed_mps: float, minutes: float = np.inf, objects: int = OBJECTS) -> Endurance:
    """Feed so many frames at 30 Hz of data, or as many as the minutes allow; both stages in one process."""
    slam, mapper, world = ObjectSlam(), ObjectMapper({}), make_code_world(objects)
    rng, samples = np.random.default_rng(0), list[tuple[float, float]]()
    every, end_s = max(min(frames // SAMPLES, MOST_BETWEEN), 1), time.monotonic() + 60.0 * minutes
    for index, (T_world_camera, sample) in enumerate(_way(world.camera, frames, speed_mps)):
        tracked = slam.step(_with_surfaces(world.observe(T_world_camera, sample.stamp_ns, rng)), sample)
        touched = tracked.loop_closed or tracked.keyframe_id >= 0
        for change in mapper.step(tracked, slam.moved_keyframes() if touched else ()):
            slam.apply_change(change)
        if index % every == every - 1:
            samples.append(((index + 1) / FRAMES_AN_HOUR, resident_mb()))
            if time.monotonic() > end_s:
                break
    hours, memory_mb = np.array(samples).T
    return Endurance(hours, memory_mb, time.process_time())


def _with_surfaces(frame: ObservedFrame) -> ObservedFrame:
    """The landmarks of the codes stand for the points that a camera sees."""
    seen = (replace(o, cloud=o.code.landmarks.astype(np.float32)) for o in frame.observations)
    return replace(frame, observations=tuple(seen))


def resident_mb() -> float:
    """Memory that this process holds."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * PAGE_MB


def _way(
    camera: Callable[[float], Array], frames: int, speed_mps: float
) -> Iterator[tuple[Array, OdometrySample]]:
    """T_world_camera and drifting odometry of every frame."""
    rng, spacing_m = np.random.default_rng(1), speed_mps * FRAME_NS / 1e9
    T_odom_camera, T_before = np.eye(4), camera(0.0)
    for index in range(frames):
        T_world_camera = camera(index * spacing_m)
        noise = exp(ODOMETRY_SIGMAS * rng.normal(size=6) * (speed_mps > 0))
        T_odom_camera = renormalized(T_odom_camera @ inverse(T_before) @ T_world_camera @ noise)
        T_before = T_world_camera
        yield T_world_camera, OdometrySample((index + 1) * FRAME_NS, T_odom_camera)


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--hours", type=float, default=1.0, help="of data at 30 frames a second (1)")
    parser.add_argument("--speed", type=float, default=0.3, help="of the camera, m/s; 0 stands (0.3)")
    parser.add_argument("--minutes", type=float, default=np.inf, help="stop after so long (never)")
    args = parser.parse_args()
    found = endure(round(args.hours * FRAMES_AN_HOUR), args.speed, args.minutes)
    for hours, memory_mb in zip(found.hours, found.memory_mb, strict=True):
        print(f"{60 * hours:8.1f} min of data {memory_mb:8.1f} MB")
    print(f"growth {found.slope_mb_per_hour:.1f} MB an hour of data; processor {found.processor_s:.0f} s")


if __name__ == "__main__":
    main()
