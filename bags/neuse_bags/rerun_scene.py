"""Messages of a bag as a scene of Rerun. Needs the package rerun-sdk.

Everything hangs below `map`: the camera with its images and the codes that it sees, the objects as meshes and
boxes, the pose graph. Time is that of the messages' stamps.
"""

from collections import defaultdict
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import trimesh
from visualization_msgs.msg import Marker

from neuse.geometry import Array
from neuse.mapping.markers import object_color
from neuse.records import ChangeKind, EdgeKind, ObjectStatus
from neuse_bags import topics
from neuse_bags.conversions import color_from_msg
from neuse_bags.mcap_file import RawMessage
from neuse_encoder_node.conversions import intrinsics_from_msg, stamp_from_msg
from neuse_encoder_node.images import depth_from_msg, mask_from_msg
from neuse_mapper_node.conversions import object_map_from_msg
from neuse_slam_node.conversions import change_from_msg, keyframes_from_msg, tracked_frame_from_msg

CAMERA, IMAGE, GRAPH = "map/camera", "map/camera/image", "map/graph"
EDGE_COLORS = {
    EdgeKind.ODOMETRY: (130, 130, 130),
    EdgeKind.SHORT_RANGE: (70, 130, 230),
    EdgeKind.LOOP_CLOSURE: (230, 60, 60),
    EdgeKind.EXTERNAL: (200, 90, 220),
}


class RerunScene:
    """Draws one message after the other; what a topic means is in `_draw`."""

    def __init__(self, recording: rr.RecordingStream) -> None:
        self._recording = recording
        self._edges: dict[tuple[int, int], EdgeKind] = {}
        self._keyframes: dict[int, Array] = {}
        self._drawn_meshes: dict[str, bytes] = {}
        self._draw: dict[str, Callable[[Any], None]] = {
            topics.COLOR.name: self._color,
            topics.DEPTH.name: self._depth,
            topics.DEPTH_INFO.name: self._camera,
            topics.MASK.name: self._mask,
            topics.FRAMES.name: self._frame,
            topics.KEYFRAMES.name: self._add_keyframes,
            topics.MAP.name: self._boxes,
            topics.MARKERS.name: self._markers,
            topics.CHANGES.name: self._change,
        }
        self._log("map", rr.ViewCoordinates.RDF, static=True)

    @property
    def topics(self) -> tuple[str, ...]:
        """The topics that are drawn."""
        return tuple(self._draw)

    def add(self, raw: RawMessage) -> None:
        """Draw a message at its stamp; raises InputError where it cannot be used."""
        message = raw.decode()
        headers = [item.header for item in getattr(message, "markers", [message])]
        if headers:
            stamp_ns = stamp_from_msg(headers[0].stamp)
            self._recording.set_time("stamp", timestamp=np.datetime64(stamp_ns, "ns"))
            self._draw[raw.topic](message)

    def _log(self, entity: str, *components: Any, static: bool = False) -> None:
        self._recording.log(entity, *components, static=static)

    def _camera(self, message: Any) -> None:
        camera = intrinsics_from_msg(message)
        K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
        pinhole = rr.Pinhole(image_from_camera=K, resolution=[camera.width, camera.height])
        self._log(IMAGE, pinhole)

    def _color(self, message: Any) -> None:
        pixels = color_from_msg(message)
        if pixels is not None:
            self._log(f"{IMAGE}/color", rr.Image(pixels).compress(jpeg_quality=80))

    def _depth(self, message: Any) -> None:
        depth_mm = np.clip(depth_from_msg(message) * 1e3, 0, 65535).astype(np.uint16)
        self._log(
            f"{IMAGE}/depth", rr.EncodedDepthImage(_png(depth_mm), media_type="image/png", meter=1000.0)
        )

    def _mask(self, message: Any) -> None:
        """Each label in a colour of its own, the background without any."""
        labels, places = np.unique(mask_from_msg(message), return_inverse=True)
        palette = np.array([object_color(int(label)) if label else (0, 0, 0, 0) for label in labels])
        rgba = (palette * 255).astype(np.uint8)[places.reshape(message.height, message.width)]
        png = _png(np.ascontiguousarray(rgba[..., [2, 1, 0, 3]]))
        self._log(f"{IMAGE}/mask", rr.EncodedImage(contents=png, media_type="image/png", opacity=0.5))

    def _frame(self, message: Any) -> None:
        """Where the camera is, and the codes of what it sees: known objects in their colours."""
        frame = tracked_frame_from_msg(message)
        self._log(CAMERA, _transform(frame.T_map_camera))
        codes = [(item.object_id, item.observation.code.landmarks) for item in frame.observations]
        points = np.concatenate([z for _, z in codes] or [np.zeros((0, 3))])
        colors = [object_color(object_id)[:3] for object_id, z in codes for _ in z]
        self._log(f"{CAMERA}/codes", rr.Points3D(points, colors=colors, radii=0.004))
        self._edges |= {(edge.from_id, edge.to_id): edge.kind for edge in frame.edges}
        if frame.edges:
            self._graph()

    def _add_keyframes(self, message: Any) -> None:
        self._keyframes = {k.keyframe_id: k.T_map_camera[:3, 3] for k in keyframes_from_msg(message)}
        self._graph()

    def _graph(self) -> None:
        """Keyframes where they are now, and the edges between them by their kinds."""
        self._log(f"{GRAPH}/keyframes", rr.Points3D(list(self._keyframes.values()), radii=0.01))
        lines: defaultdict[EdgeKind, list[list[Array]]] = defaultdict(list)
        for ends, kind in self._edges.items():
            if all(end in self._keyframes for end in ends):
                lines[kind].append([self._keyframes[end] for end in ends])
        for kind, strips in lines.items():
            self._log(f"{GRAPH}/{kind.name.lower()}", rr.LineStrips3D(strips, colors=[EDGE_COLORS[kind]]))

    def _boxes(self, message: Any) -> None:
        known = object_map_from_msg(message).objects
        self._log(
            "map/boxes",
            rr.Boxes3D(
                centers=[item.box_center for item in known],
                sizes=[item.box_size for item in known],
                quaternions=[rr.Quaternion(xyzw=_quaternion(m.pose)) for m in message.objects],
                labels=[_name(item.category, item.object_id, item.status) for item in known],
                colors=[object_color(item.object_id)[:3] for item in known],
            ),
        )

    def _markers(self, message: Any) -> None:
        """The meshes among the markers; labels and arrows have their equals in boxes and changes."""
        meshes = {f"map/objects/{m.id}": m for m in message.markers if m.type == Marker.TRIANGLE_LIST}
        for entity in sorted(self._drawn_meshes.keys() - meshes.keys()):
            del self._drawn_meshes[entity]
            self._log(entity, rr.Clear(recursive=True))
        for entity, marker in meshes.items():
            self._mesh(entity, marker)

    def _mesh(self, entity: str, marker: Any) -> None:
        """A mesh, unless it is drawn already."""
        corners = np.array([(p.x, p.y, p.z) for p in marker.points], dtype=np.float32)
        if self._drawn_meshes.get(entity) == corners.tobytes():
            return
        self._drawn_meshes[entity] = corners.tobytes()
        mesh = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3))
        drawn = rr.Mesh3D(
            vertex_positions=mesh.vertices,
            triangle_indices=mesh.faces,
            vertex_normals=mesh.vertex_normals,
            albedo_factor=[marker.color.r, marker.color.g, marker.color.b, marker.color.a],
        )
        self._log(entity, drawn)

    def _change(self, message: Any) -> None:
        change = change_from_msg(message)
        told = f"{change.category} {change.object_id} {change.kind.name.lower()}"
        self._log("changes", rr.TextLog(told, level="INFO"))
        before, after = change.T_map_before, change.T_map_after
        if change.kind == ChangeKind.MOVED and before is not None and after is not None:
            arrow = rr.Arrows3D(origins=[before[:3, 3]], vectors=[after[:3, 3] - before[:3, 3]], radii=0.006)
            self._log(f"map/changes/{change.object_id}", arrow)


def blueprint() -> rrb.Blueprint:
    """The map beside what the camera sees, and the changes below."""
    views = rrb.Horizontal(
        rrb.Spatial3DView(origin="map", name="Map"),
        rrb.Vertical(
            rrb.Spatial2DView(origin=IMAGE, contents=[f"{IMAGE}/color", f"{IMAGE}/mask"], name="Colour"),
            rrb.Spatial2DView(origin=IMAGE, contents=[f"{IMAGE}/depth"], name="Depth"),
            rrb.TextLogView(origin="changes", name="Changes"),
        ),
        column_shares=[2, 1],
    )
    return rrb.Blueprint(views, collapse_panels=True)


def _transform(T_target_source: Array) -> rr.Transform3D:
    return rr.Transform3D(translation=T_target_source[:3, 3], mat3x3=T_target_source[:3, :3])


def _quaternion(pose: Any) -> list[float]:
    q = pose.orientation
    return [q.x, q.y, q.z, q.w]


def _name(category: str, object_id: int, status: ObjectStatus) -> str:
    return f"{category} {object_id}" + ("" if status == ObjectStatus.UNCHANGED else f" {status.name.lower()}")


def _png(pixels: np.ndarray) -> bytes:
    done, data = cv2.imencode(".png", pixels)
    assert done
    return data.tobytes()
