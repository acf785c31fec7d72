"""Whether a bag has what the graph needs, found out from its topics, stamps, and some of its frames."""

import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rclpy.qos import ReliabilityPolicy

from neuse.errors import InputError
from neuse_bags import topics
from neuse_bags.compressed import PACKED_TYPE, TYPE
from neuse_bags.frames import JOINED, read_frames
from neuse_bags.mcap_file import BagReader, BagTopic
from neuse_bags.roles import ROLES, Role
from neuse_bags.scale import ScaleCheck
from neuse_bags.trajectory_files import another_clock
from neuse_encoder_node.conversions import is_distorted

N_SAMPLES = 20
Stamps = Mapping[str, Sequence[int]]


@dataclass(frozen=True)
class BagReport:
    """What a bag has for the graph.

    found: the topic of each role that is there.    n_frames: stamps that all needed topics share.
    categories: how often each was detected.    faults: what keeps the graph from working, and the way out.
    notes: what it can live with.
    """

    path: Path
    duration_s: float
    found: tuple[tuple[Role, BagTopic], ...]
    n_frames: int
    categories: Counter[str]
    faults: tuple[str, ...]
    notes: tuple[str, ...]


class Finding(NamedTuple):
    """One line for people; fatal: the graph cannot work so."""

    text: str
    fatal: bool = True


def inspect_bag(bag: BagReader, known_categories: Collection[str] | None = None) -> BagReport:
    """Look through a bag. known_categories: those that there are weights for; None: any.

    Raises:
        BagError: the bag is damaged.
    """
    found = tuple((role, bag.topics[role.topic.name]) for role in ROLES if role.topic.name in bag.topics)
    findings = [*_missing(bag), *_notes(found), *_several_cameras(bag)]
    paired_ns, categories = list[int](), Counter[str]()
    if not any(finding.fatal for finding in findings):
        stamps_ns, categories = _read_stamps(bag)
        paired_ns = sorted(set.intersection(*map(set, stamps_ns.values())))
        known = known_categories or categories
        findings += [*_pairing(stamps_ns, len(paired_ns)), *_other_clocks(bag, paired_ns)]
        findings += [*_category_faults(categories, known), *_frame_faults(bag, paired_ns, known)]
        findings += _distortion(bag)
    duration_s = max(bag.end_ns - bag.start_ns, 0) / 1e9
    faults, notes = (tuple(f.text for f in findings if f.fatal == fatal) for fatal in (True, False))
    return BagReport(bag.path, duration_s, found, len(paired_ns), categories, faults, notes)


def _missing(bag: BagReader) -> Iterator[Finding]:
    """Topics that are not there, of another type, or empty."""
    for role in ROLES:
        name, type_name = role.topic.name, role.topic.type_name
        topic = bag.topics.get(name)
        if topic is None and role.needed:
            yield Finding(f"{name} is missing ({type_name}: {role.meaning}){_hint(bag, role)}")
        elif topic is not None and topic.type_name != type_name:
            yield Finding(f"{name} has type {topic.type_name}; record it as {type_name}")
        elif topic is not None and role.needed and not topic.n_messages:
            yield Finding(f"{name} has no message; was its publisher running?")


def _hint(bag: BagReader, role: Role) -> str:
    """Topics of the same type, or of such images compressed, under other names."""
    own = {known.topic.name for known in ROLES} | {topic.name for topic in topics.OUTPUT_TOPICS}
    types = {role.topic.type_name} | ({PACKED_TYPE} if role.topic.type_name == TYPE else set())
    alike = [t.name for t in bag.topics.values() if t.type_name in types and t.name not in own]
    if not alike:
        return ""
    alike.sort(key=lambda name: -len(_words(name) & _words(role.topic.name)))
    return f"; is it {' or '.join(alike)}? then: convert {bag.path} --remap {alike[0]}:={role.topic.name}"


def _words(name: str) -> set[str]:
    return set(re.split("[/_]", name)) - {""}


def _notes(found: Sequence[tuple[Role, BagTopic]]) -> Iterator[Finding]:
    """What is not as it could be, and does no harm."""
    for role, topic in found:
        if role.needed and any(q.reliability == ReliabilityPolicy.BEST_EFFORT for q in topic.qos):
            told = f"{topic.name} is best effort: leave input_reliable of encoder_node false"
            yield Finding(told, fatal=False)
    if topics.ODOMETRY.name not in {topic.name for _, topic in found}:
        yield Finding(f"no {topics.ODOMETRY.name}: frames without known objects have no pose", fatal=False)


def _several_cameras(bag: BagReader) -> Iterator[Finding]:
    """Which need a graph each."""
    namespaces = topics.namespaces_in(bag)
    if len(namespaces) > 1 and all(namespaces):
        cameras = ", ".join(namespaces)
        choice = f"look at one, --namespace {namespaces[0]}, or let them share a map (docs/maps.md)"
        told = f"{cameras} have {topics.DEPTH.name[1:]}: {choice}"
        yield Finding(told, fatal=False)


def _read_stamps(bag: BagReader) -> tuple[Stamps, Counter[str]]:
    """Header stamps of the needed topics, and the categories of all instances."""
    stamps_ns: dict[str, list[int]] = {name: [] for name in JOINED}
    categories: Counter[str] = Counter()
    for message in bag.messages(JOINED):
        stamps_ns[message.topic].append(message.header_stamp_ns)
        if message.topic == topics.INSTANCES.name:
            categories.update(item.category for item in message.decode().instances)
    return stamps_ns, categories


def _pairing(stamps_ns: Stamps, n_paired: int) -> Iterator[Finding]:
    """Stamps that repeat, and topics whose stamps are not those of the depth images."""
    depth_ns = np.unique(stamps_ns[topics.DEPTH.name])
    n_images = len(stamps_ns[topics.DEPTH.name])
    if 2 * len(depth_ns) < n_images:
        told = f"{n_images} images on {topics.DEPTH.name} have {len(depth_ns)} stamps; set each header.stamp"
        yield Finding(told)
    for name in JOINED[1:]:
        own_ns = np.unique(stamps_ns[name])
        n_equal = len(np.intersect1d(depth_ns, own_ns))
        if n_equal < len(depth_ns):
            told = f"{n_equal} of {len(depth_ns)} stamps of {topics.DEPTH.name} are on {name}, whose nearest "
            told += f"are {_offset_ms(depth_ns, own_ns):+.3f} ms away; give every {name} the header.stamp of "
            yield Finding(f"{told}its depth image", fatal=2 * n_paired < len(depth_ns))


def _offset_ms(stamps_ns: np.ndarray, others_ns: np.ndarray) -> float:
    """Median way from a stamp to the nearest of the others."""
    offsets_ns = [(others_ns - stamp_ns)[np.argmin(np.abs(others_ns - stamp_ns))] for stamp_ns in stamps_ns]
    return float(np.median(offsets_ns)) / 1e6


def _other_clocks(bag: BagReader, frames_ns: Sequence[int]) -> Iterator[Finding]:
    """Topics of poses, none of which is at the time of a frame."""
    for name in (topics.ODOMETRY.name, topics.TRUE_ODOMETRY.name):
        apart = another_clock([message.header_stamp_ns for message in bag.messages([name])], frames_ns)
        if apart:
            yield Finding(f"{name}: {apart}; give both the stamps of one clock, or leave {name} out")


def _frame_faults(bag: BagReader, paired_ns: Sequence[int], known: Collection[str]) -> Iterator[Finding]:
    """What is wrong with some frames out of the whole bag, each kind of fault once."""
    from neuse_bags.usable import UsableCheck  # loads torch, which folders are converted without

    chosen = np.linspace(0, len(paired_ns) - 1, min(N_SAMPLES, len(paired_ns))).astype(int)
    faults: list[InputError] = []
    scale, usable = ScaleCheck(), UsableCheck(known)
    for frame in read_frames(bag, faults.append, {paired_ns[index] for index in chosen}):
        try:
            usable.add(frame)
            scale.add(frame)
        except InputError as fault:
            faults.append(fault)
    yield from _whole_frames(faults, len(chosen))
    unit = scale.fault()
    if unit:
        told = f"{topics.DEPTH.name}: {unit.text}; send 16UC1 in millimetres or 32FC1 in metres"
        yield Finding(f"{told}: multiply by {unit.factor:g}")
    elif usable.refused():
        told = f"{usable.n_usable} instances in {len(chosen)} frames can be used; refused: {usable.refused()}"
        yield Finding(f"{topics.MASK.name}, {topics.DEPTH.name}: {told}", fatal=not usable.n_usable)


def _whole_frames(faults: Sequence[InputError], n_frames: int) -> Iterator[Finding]:
    """Frames that cannot be used at all; few of them do no harm."""
    by_reason = {fault.reason: _named(fault) for fault in reversed(faults)}
    fatal = 2 * len(faults) > n_frames
    few = "" if fatal else f" (of {n_frames} frames looked at, {len(faults)} cannot be used)"
    yield from (Finding(f"{text}{few}", fatal) for text in by_reason.values())


def _distortion(bag: BagReader) -> Iterator[Finding]:
    """Pictures of a camera with a distortion must be rectified, which nothing in the bag can show."""
    first = next(bag.messages([topics.DEPTH_INFO.name]))
    if is_distorted(first.decode()):
        told = (
            f"{topics.DEPTH_INFO.name} has a distortion: depth and mask are taken to be rectified, with p as"
        )
        yield Finding(f"{told} their camera; if they are not, let image_proc rectify them", fatal=False)


def _named(fault: InputError) -> str:
    """A fault of a frame with the topic that is to be corrected."""
    if fault.reason == "intrinsics":
        return f"{topics.DEPTH_INFO.name}: {fault}; fill in k = [fx, 0, cx, 0, fy, cy, 0, 0, 1]"
    if fault.reason == "intrinsics_size":
        return f"{topics.DEPTH_INFO.name}: {fault}; send the camera info of the depth image"
    return f"{topics.DEPTH.name}, {topics.MASK.name}: {fault}"


def _category_faults(categories: Counter[str], known: Collection[str]) -> Iterator[Finding]:
    """Categories that there are no weights for."""
    unknown = sorted(categories.keys() - set(known))
    if not categories:
        yield Finding(f"{topics.INSTANCES.name} has no instance at all; did the segmenter find nothing?")
    elif unknown:
        told = f"no weights for {', '.join(unknown)}; there are some for {', '.join(sorted(known))}"
        yield Finding(told, fatal=len(unknown) == len(categories))
