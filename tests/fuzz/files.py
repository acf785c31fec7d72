"""Files: maps, weights, bags, pictures and lists of people's own data, meshes."""

import io
import itertools
import json
import math
import shutil
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import redirect_stderr
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import safetensors.torch
import trimesh
from bags.layouts import make_bop, make_tum
from embedding.tiny import make_network, partial_cloud
from hypothesis import strategies as st
from nodes import samples

from neuse.embedding.embedding import Embedding, load_embedding
from neuse.embedding.network import save_network
from neuse.mapping.mapper import ObjectMapper
from neuse.records import RgbdFrame
from neuse.simulation import closing
from neuse.simulation.meshes import load_meshes
from neuse_bags import topics
from neuse_bags.conversions import odometry_to_msg
from neuse_bags.convert import open_source
from neuse_bags.frames import read_frames, write_frame
from neuse_bags.inspection import inspect_bag
from neuse_bags.mcap_file import BagReader, BagWriter
from neuse_bags.parameter_file import read_node_params
from neuse_bags.recording import read_estimate, read_truth
from neuse_bags.renamed import read_names
from neuse_encoder_node.conversions import observed_frame_to_msg
from neuse_mapper_node.conversions import object_map_to_msg
from neuse_slam_node.conversions import keyframes_to_msg, tracked_frame_to_msg

from .messages import mug_frame, toured_mapper
from .soundness import assert_sound
from .spoiling import spoiled_bytes, spoiled_json, spoiled_text
from .target import Target

MESHES = ("obj", "ply", "stl", "glb")
COARSE_CELLS = 16
PARAMETER_FILE = """
/**:
  ros__parameters: {use_sim_time: true, queue_size: 5}
/a/slam_node:
  ros__parameters:
    T_child_camera: [0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0]
    slam: {mode: edges, odometry: {sigma_translation_m: 0.01}, use_ambiguous: false}
encoder_node:
  ros__parameters: {weights: [mug, bottle], encoder.min_points: 30}
"""
_numbers = itertools.count()


def file_targets(folder: Path) -> Iterator[Target]:
    """One for each kind of file; folder: where files are written."""
    yield from _map_targets(folder)
    yield from _weights_targets(folder)
    yield from _bag_targets(folder)
    yield from _layout_targets(folder)
    yield from _mesh_targets(folder)
    yield Target(
        "remap table", spoiled_text("/a/b: /depth/image\n/c: /segmentation/mask\n"), _read_table(folder)
    )
    yield Target("parameter file", spoiled_text(PARAMETER_FILE), _read_parameters(folder))


def _map_targets(folder: Path) -> Iterator[Target]:
    path = folder / "sound.map"
    toured_mapper().save(path)
    with zipfile.ZipFile(path) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()}

    def read(path: Path) -> None:
        mapper = ObjectMapper({})
        mapper.load(path)
        assert_sound(mapper.object_map)

    yield Target("map file, bytes", spoiled_bytes(path.read_bytes()), _at(folder / "bytes.map", read))
    spoiled = st.sampled_from(sorted(members)).flatmap(
        lambda name: spoiled_bytes(members[name]).map(lambda data: zipped(members | {name: data}))
    )
    yield Target("map file, arrays", spoiled, _at(folder / "arrays.map", read))
    header = json.loads(np.lib.format.read_array(io.BytesIO(members["header.npy"])).tobytes())
    headers = spoiled_json(header).map(lambda content: zipped(members | {"header.npy": _npy(content)}))
    yield Target("map file, header", headers, _at(folder / "header.map", read))


def zipped(members: Mapping[str, bytes]) -> bytes:
    """An archive of these files."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return stream.getvalue()


def _npy(content: Any) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.frombuffer(json.dumps(content).encode(), dtype=np.uint8))
    return stream.getvalue()


def _weights_targets(folder: Path) -> Iterator[Target]:
    path = folder / "sound.safetensors"
    save_network(make_network(), path, {"seed": 1})
    whole = path.read_bytes()
    end = 8 + int.from_bytes(whole[:8], "little")
    header, cloud = json.loads(whole[8:end]), partial_cloud(np.random.default_rng(0), 64)
    tensors = safetensors.torch.load(whole)

    def read(path: Path) -> None:
        embedding = load_embedding(path)
        assert isinstance(embedding, Embedding)
        (code,) = embedding.encode([cloud])
        assert code.category == embedding.category

    def headed(content: Any) -> bytes:
        text = json.dumps(content).encode()
        return len(text).to_bytes(8, "little") + text + whole[end:]

    def described(entry: Mapping[str, Any]) -> bytes:
        metadata = {
            str(name): text if isinstance(text, str) else json.dumps(text) for name, text in entry.items()
        }
        return safetensors.torch.save(tensors, metadata)

    metadata = {name: _decoded(text) for name, text in header["__metadata__"].items()}
    yield Target("weights, bytes", spoiled_bytes(whole), _at(folder / "bytes.safetensors", read))
    yield Target(
        "weights, header", spoiled_json(header).map(headed), _at(folder / "header.safetensors", read)
    )
    objects = spoiled_json(metadata).filter(lambda content: isinstance(content, dict))
    yield Target("weights, metadata", objects.map(described), _at(folder / "metadata.safetensors", read))


def _decoded(text: str) -> Any:
    try:
        return json.loads(text) if text[0] in "{tf" else text
    except ValueError:
        return text


def _bag_targets(folder: Path) -> Iterator[Target]:
    bag, recording = folder / "sound.mcap", folder / "recording.mcap"
    with BagWriter(bag) as writer:
        topics.declare(writer, (*topics.FRAME_TOPICS, topics.ODOMETRY, *topics.TRUTH_TOPICS))
        frame = mug_frame()
        write_frame(writer, frame)
        for spec in (topics.ODOMETRY, topics.TRUE_ODOMETRY):
            writer.write(spec.name, odometry_to_msg(frame.stamp_ns, np.eye(4), "odom"), frame.stamp_ns)
    with BagWriter(recording) as writer:
        topics.declare(writer, topics.OUTPUT_TOPICS)
        for spec, message in (
            (topics.OBSERVATIONS, observed_frame_to_msg(samples.observed_frame(), "camera")),
            (topics.FRAMES, tracked_frame_to_msg(samples.tracked_frame(), "map", "camera")),
            (topics.KEYFRAMES, keyframes_to_msg(samples.keyframes(), samples.STAMP_NS, "map")),
            (topics.MAP, object_map_to_msg(samples.object_map(), "map")),
        ):
            writer.write(spec.name, message, samples.STAMP_NS)

    def inspect(path: Path) -> None:
        with BagReader(path) as reader:
            inspect_bag(reader)
            list(read_frames(reader, lambda error: None))
        read_truth(path)

    yield Target("bag", spoiled_bytes(bag.read_bytes()), _at(folder / "spoiled.mcap", inspect))
    yield Target(
        "recording",
        spoiled_bytes(recording.read_bytes()),
        _at(folder / "spoiled_recording.mcap", lambda path: _read_estimate(path)),
    )


def _read_estimate(path: Path) -> None:
    read_estimate(path)


def _layout_targets(folder: Path) -> Iterator[Target]:
    """Lists, JSON files and pictures of the three layouts of folders."""
    for make in (make_tum, make_bop, make_plain):
        sound = make(folder / make.__name__)
        for path in sorted(path for path in sound.rglob("*") if path.is_file()):
            if any(other.suffix == path.suffix == ".png" and other < path for other in path.parent.iterdir()):
                continue  # one picture of each folder will do
            name = f"{sound.name.removeprefix('make_')} {path.relative_to(sound)}"
            yield Target(name, _spoiled_file(path), _in_place(sound, path))


def _spoiled_file(path: Path) -> st.SearchStrategy[bytes]:
    data = path.read_bytes()
    if path.suffix == ".json":
        return spoiled_json(json.loads(data)).map(lambda content: json.dumps(content).encode())
    if path.suffix in (".txt", ".tum"):
        return spoiled_text(data.decode()).map(lambda text: text.encode(errors="replace"))
    return spoiled_bytes(data)


def _in_place(sound: Path, path: Path) -> Callable[[bytes], None]:
    """The folder is read with one of its files spoiled."""
    whole = path.read_bytes()

    def read(data: bytes) -> None:
        path.write_bytes(data)
        try:
            source = open_source(sound)
            assert_sound((source.trajectories.odometry, source.trajectories.ground_truth))
            for frame in source.frames():
                _assert_frame(frame)
        finally:
            path.write_bytes(whole)

    return read


def _assert_frame(frame: RgbdFrame) -> None:
    assert_sound((frame.stamp_ns, frame.intrinsics, frame.instances))
    size = (frame.intrinsics.height, frame.intrinsics.width)
    assert frame.depth_m.shape == frame.mask.shape == size
    assert np.isfinite(frame.depth_m).all()
    assert frame.color is None or frame.color.shape == (*size, 3)


def make_plain(path: Path) -> Path:
    """The plain layout, made of the pictures of another."""
    source = make_tum(path.with_name("pictures"))
    path.mkdir(exist_ok=True)
    for kind, name in (("depth", "depth"), ("masks", "mask"), ("rgb", "color")):
        picture = sorted((source / kind).glob("*.png"))[0]
        shutil.copy(picture, path / f"00_{name}.png")
    camera = json.loads((source / "camera.json").read_text())
    instances = [{"id": 1, "category": "mug", "score": 0.5}, {"id": 2, "category": "bottle"}]
    frames = [{"frame": 0, "stamp_s": 1.5, "instances": instances}]
    content = {"intrinsics": camera, "frames": frames, "rate_hz": 10.0, "depth_scale_m": 0.001}
    (path / "frames.json").write_text(json.dumps(content))
    (path / "odometry.tum").write_text("1.5 1 2 3 0 0 0.6 0.8\n")
    shutil.rmtree(source)
    return path


def _mesh_targets(folder: Path) -> Iterator[Target]:
    mesh = trimesh.creation.annulus(r_min=0.03, r_max=0.05, height=0.1, sections=8)
    for kind in MESHES:
        data = mesh.export(file_type=kind)
        whole = data.encode() if isinstance(data, str) else data
        spoiled = spoiled_bytes(whole)
        if isinstance(data, str):
            spoiled |= spoiled_text(data).map(lambda text: text.encode(errors="replace"))
        yield Target(f"mesh {kind}", spoiled, _at(folder / kind / "mug" / f"mesh.{kind}", _load_mesh))


def _load_mesh(path: Path) -> None:
    with mock.patch.object(closing, "CELLS", COARSE_CELLS):  # an open mesh takes seconds at full resolution
        shapes = load_meshes(path.parent.parent, "mug")
    for shape in shapes:
        assert shape.mesh.is_volume
        assert np.isfinite(shape.mesh.vertices).all()


def _read_table(folder: Path) -> Callable[[str], None]:
    def read(text: str) -> None:
        path = folder / "names.yaml"
        path.write_text(text, errors="replace")
        names = read_names([str(path)])
        assert all(isinstance(word, str) for word in [*names, *names.values()])

    return read


def _read_parameters(folder: Path) -> Callable[[str], None]:
    def read(text: str) -> None:
        path = folder / "params.yaml"
        path.write_text(text, errors="replace")
        assert all(map(math.isfinite, read_node_params(path).slam_node.camera_pose.flat))

    return read


def _at(path: Path, read: Callable[[Path], None]) -> Callable[[bytes], None]:
    """The bytes as a file."""
    path.parent.mkdir(parents=True, exist_ok=True)

    def write_and_read(data: bytes) -> None:
        path.write_bytes(data)
        with redirect_stderr(io.StringIO()):
            read(path)

    return write_and_read
