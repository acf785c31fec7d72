"""A few frames of a run with what was decoded from each alone, for the report."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from neuse.errors import InputError
from neuse.evaluation.map_scene import Reconstruct
from neuse.evaluation.reconstructions import ReconstructedFrame, reconstruct_frame, telling_frames
from neuse.records import ObservedFrame
from neuse_bags import topics
from neuse_bags.frames import JOINED, read_frames, with_color
from neuse_bags.mcap_file import BagReader
from neuse_encoder_node.conversions import observed_frame_from_msg

N_VIEWS = 3


def read_observed(recording: Path) -> list[ObservedFrame]:
    """What the encoder made of every frame of a run; empty where that was not recorded."""
    with BagReader(recording) as bag:
        messages = bag.messages([topics.OBSERVATIONS.name])
        return [observed_frame_from_msg(message.decode()) for message in messages]


def read_views(
    path: Path,
    observed: Sequence[ObservedFrame],
    reconstruct: Mapping[str, Reconstruct],
    namespace: str = "",
) -> list[ReconstructedFrame]:
    """The frames that show most, from the bag that was fed to the run; empty where it lacks the images.

    reconstruct: by category, code -> mesh in the code's frame.
    """
    by_stamp = {frame.stamp_ns: frame for frame in telling_frames(observed, N_VIEWS)}
    with BagReader(path, namespace) as bag:
        if not bag.topics.keys() >= set(JOINED):
            return []
        frames = with_color(bag, list(read_frames(bag, _pass_over, by_stamp)))
    return [reconstruct_frame(frame, by_stamp[frame.stamp_ns], reconstruct) for frame in frames]


def _pass_over(fault: InputError) -> None:
    """The run has told it already."""
