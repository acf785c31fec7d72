"""The change-aware object map (NeuSE IV-D, appendix): tracked frames in, changes and full shapes out."""

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field
from pathlib import Path

import trimesh

from neuse.geometry import Array
from neuse.mapping.change_detection import ChangeDetector, ChangeParams, Move
from neuse.mapping.evidence import Evidence
from neuse.mapping.free_space import FreeSpaceParams
from neuse.mapping.history import History
from neuse.mapping.intake import Intake
from neuse.mapping.judge import Judge, Origin
from neuse.mapping.keyframe_memory import KeyframeMemory
from neuse.mapping.map_file import load_map, save_map
from neuse.mapping.newcomer import NewcomerParams
from neuse.mapping.object_graph import LayoutParams
from neuse.mapping.object_library import LibraryParams, ObjectLibrary
from neuse.mapping.presence import Presence
from neuse.mapping.reconstruction import MeshCache, Reconstruct
from neuse.mapping.shapes import Shapes
from neuse.mapping.snapshot import restore, snapshot
from neuse.mapping.upkeep import UpkeepParams
from neuse.params import CheckedParams, param
from neuse.records import (
    NO_ID,
    ChangeKind,
    Keyframe,
    ObjectChange,
    ObjectMap,
    ObjectStatus,
    TrackedFrame,
)
from neuse.slam.prior_map import in_their_places


@dataclass(frozen=True)
class MapperParams(CheckedParams):
    """Parameters of the mapper; nested names are dotted ROS parameter names."""

    max_depth_keyframes: int = param(
        1000, "keyframes whose depth thumbnails are kept as evidence", 3, 1000000
    )
    redecode_rms_m: float = param(
        0.005, "a shape is decoded anew when its code changed by this rms", 0.0, 1.0
    )
    library: LibraryParams = field(default_factory=LibraryParams)
    layout: LayoutParams = field(default_factory=LayoutParams)
    free_space: FreeSpaceParams = field(default_factory=FreeSpaceParams)
    newcomers: NewcomerParams = field(default_factory=NewcomerParams)
    upkeep: UpkeepParams = field(default_factory=UpkeepParams)
    changes: ChangeParams = field(default_factory=ChangeParams)


class ObjectMapper:
    """Builds and maintains the object map, one tracked frame a step."""

    def __init__(self, reconstruct: Mapping[str, Reconstruct], params: MapperParams = MapperParams()) -> None:
        self._reconstruct, self._params = reconstruct, params
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        params = self._params
        self._tick, self._stamp_ns = 0, 0
        self.history: tuple[ObjectChange, ...] = ()  # of a loaded map, before the present run
        self._memory = KeyframeMemory(params.max_depth_keyframes)
        self._reports = History(self._memory.poses)
        self._library = ObjectLibrary()
        self._meshes = MeshCache(self._reconstruct, params.redecode_rms_m)
        self._shapes = Shapes(self._library, self._meshes)
        self._evidence = Evidence(self._memory, self._library, params.layout, params.free_space)
        self._presence = Presence(self._evidence, params.newcomers.min_empty_keyframes)
        self._judge = Judge(self._library, self._evidence, self._meshes, params.newcomers, params.upkeep)
        self._detector = ChangeDetector(params.changes)
        self._intake = Intake(self._library, self._memory, self._judge, params.library)
        self._newcomers, self._doubtful = set[int](), set[int]()

    def step(self, frame: TrackedFrame, keyframes: Sequence[Keyframe] = ()) -> tuple[ObjectChange, ...]:
        """Take in a frame and the latest keyframe estimates; the changes that have become certain."""
        self._tick += 1
        self._stamp_ns = frame.stamp_ns
        self._library.invalidate(self._memory.update(frame, keyframes, self._tick))
        self._newcomers |= self._intake.add(frame, self._tick)
        if frame.keyframe_id != NO_ID:
            keyframe = self._memory.seen[frame.keyframe_id]
            seen_ids = self._intake.seen_for_sure(frame, keyframe)
            self._presence.update(keyframe, self._memory, self._library, seen_ids)
            self._judge_newcomers(set(keyframe.centers))
        if frame.loop_closed:
            self.merge_duplicates()
        return self._detect_changes(final=False)

    def finalize(self) -> tuple[ObjectChange, ...]:
        """Decide what is still waiting for evidence, at the end of a bag or when the camera stops."""
        self._judge_newcomers(self._newcomers)
        self.merge_duplicates()
        changes = self._detect_changes(final=True)
        while further := self._detect_changes(final=True):  # what a move has displaced may have moved, too
            changes += further
        return changes

    @property
    def changes(self) -> tuple[ObjectChange, ...]:
        """All changes so far as the map has them now, without reports that a later one has superseded."""
        return self._reports.changes

    @property
    def object_map(self) -> ObjectMap:
        """The map as it is now; removed objects stay listed, as REMOVED."""
        return self._shapes.object_map(self._stamp_ns)

    @property
    def sketch(self) -> ObjectMap:
        """The map in no time: boxes are of the shapes decoded last, or of the points seen."""
        return self._shapes.object_map(self._stamp_ns, now=False)

    def decode_next(self) -> bool:
        """Bring the one shape up to date that lags most behind its code; False where none does."""
        return self._shapes.decode_next()

    def places(self) -> dict[int, Array]:
        """{object id: (3,) centre, map frame} of all objects, those that are gone where they were."""
        return {record.object_id: record.center for record in self._library}

    def merge_duplicates(self) -> None:
        """Objects that drift had kept apart, or that two sessions have named at once, are one."""
        for duplicate_id, kept_id in self._judge.duplicates():
            self._merge(duplicate_id, kept_id)

    def settle_names(self, index: int = 0, n_sessions: int = 1) -> None:
        """Session `index` names objects anew: nothing means any more what it meant by a name before."""
        for keyframe in self._memory.seen.values():
            keyframe.centers = {self._library.resolve(i): center for i, center in keyframe.centers.items()}
        aliases = self._library.aliases
        self._library.aliases = {i: aliases[i] for i in aliases if i % n_sessions != index}

    def mesh(self, object_id: int, now: bool = True) -> trimesh.Trimesh:
        """Full shape of an object, map frame; with `now=False` as it was decoded last.

        Raises:
            InputError: no such object.    MeshError: its category has no decoder, or it lacks a shape yet.
        """
        return self._shapes.mesh(object_id, now)

    def save(self, path: str | Path) -> None:
        """Write objects, evidence of free space, and all changes to a file.

        Raises:
            MapFileError: the place cannot be written.
        """
        changes = (*self.history, *self.changes)
        save_map(Path(path), snapshot(self._library, self._memory, changes, self._tick, self._stamp_ns))

    def load(self, path: str | Path) -> None:
        """Go on with a saved map; what was known before is forgotten. Object ids are kept.

        Raises:
            MapFileError: missing, damaged, or of another version; the present map is kept.
        """
        stored = load_map(Path(path))
        self.reset()
        self._stamp_ns, self.history = stored.stamp_ns, stored.changes
        restore(stored, self._library, self._memory)

    def is_in(self, object_map: ObjectMap) -> bool:
        """Whether what is known here stands where that map has it, as far as both know the same objects."""
        here, there = self.places(), {known.object_id: known.code.center for known in object_map.objects}
        return here.keys().isdisjoint(there) or in_their_places(here, there) is True

    def recall(self, object_map: ObjectMap) -> int:
        """Take over what an earlier mapper of this session knew; how many objects that are new here.

        Of objects that are known here again their history is taken over, and their places if this mapper was
        loaded with earlier ones. A map later than the latest frame is of another session,
        unless this mapper was loaded with what that one knew once. A session that is not in that map has yet
        to find its place there: what it has seen so far is forgotten.
        """
        if object_map.stamp_ns > self._stamp_ns and not self._library.is_earlier_than(object_map):
            return 0
        if not self.is_in(object_map):
            stamp_ns = self._stamp_ns
            self.reset()
            self._stamp_ns = stamp_ns
        recalled = [self._library.recall(known, self._memory.poses) for known in object_map.objects]
        for known in object_map.objects:
            self._forget(self._library.resolve(known.object_id))
        return sum(recalled)

    def _judge_newcomers(self, object_ids: Set[int]) -> None:
        """Settle what the newcomers among these objects are."""
        for object_id in sorted(self._newcomers & object_ids):
            verdict = self._judge.judge(self._library.records[object_id])
            self._doubtful.discard(object_id)
            if verdict.is_doubtful:
                self._doubtful.add(object_id)
            if verdict.origin == Origin.OPEN:
                continue
            self._newcomers.discard(object_id)
            if verdict.duplicate_of is not None:
                self._merge(object_id, verdict.duplicate_of)
            elif verdict.origin == Origin.CHANGE:
                self._detector.note_come(object_id, self._stamp_ns)
                for displaced_id in verdict.displaced:
                    self._presence.displace(displaced_id, object_id)

    def _merge(self, duplicate_id: int, kept_id: int) -> None:
        """One object under two ids."""
        self._library.merge(duplicate_id, kept_id)
        self._reports.take_back_added(duplicate_id)
        self._forget(duplicate_id)
        self._presence.withdraw(duplicate_id)
        self._presence.forget(kept_id)

    def _detect_changes(self, final: bool) -> tuple[ObjectChange, ...]:
        """Pair what went with what came, and report what has become certain."""
        changes = self._note_presence()
        disputed = self._presence.disputed(self._detector.waiting)
        decision = self._detector.decide(self._library, self._stamp_ns, final, self._doubtful, disputed)
        changes += [self._move(move) for move in decision.moves]
        added = [object_id for object_id in decision.added if not self._is_known_after_all(object_id)]
        changes += [self._change(object_id, ChangeKind.ADDED) for object_id in added]
        removed = [object_id for object_id in decision.removed if self._presence.is_gone(object_id)]
        changes += [self._change(object_id, ChangeKind.REMOVED) for object_id in removed]
        return tuple(changes)

    def _is_known_after_all(self, object_id: int) -> bool:
        """What has come for sure may look like an object that stands there, now that more has been seen."""
        known_id = self._judge.judge(self._library.records[object_id]).duplicate_of
        if known_id is not None:
            self._merge(object_id, known_id)
        return known_id is not None

    def _note_presence(self) -> list[ObjectChange]:
        """Tell the detector who is gone. An object called removed that is matched again has been added."""
        back = []
        for record in self._library:
            if not record.is_present:
                if self._presence.has_returned(record.object_id):
                    self._presence.forget(record.object_id)
                    self._detector.note_present(record.object_id)
                    back.append(self._change(record.object_id, ChangeKind.ADDED))
            elif self._presence.is_gone(record.object_id):
                self._detector.note_gone(record.object_id, self._stamp_ns)
            else:
                self._detector.note_present(record.object_id)
        return back

    def _change(self, object_id: int, kind: ChangeKind) -> ObjectChange:
        """Mark an object as added or removed."""
        record = self._library.records[object_id]
        added = kind == ChangeKind.ADDED
        record.status = ObjectStatus.ADDED if added else ObjectStatus.REMOVED
        return self._reports.report(
            self._stamp_ns, kind, record, None if added else record, record if added else None
        )

    def _move(self, move: Move) -> ObjectChange:
        """Let an object take over the place of the newcomer that it is."""
        record, newcomer = (self._library.records[i] for i in (move.object_id, move.newcomer_id))
        change = self._reports.report(self._stamp_ns, ChangeKind.MOVED, record, record, newcomer)
        for displaced_id in self._judge.displaced_by(newcomer):
            if displaced_id != move.object_id:
                self._presence.displace(displaced_id, move.object_id)
        self._library.move(move.object_id, move.newcomer_id)
        self._newcomers.discard(move.object_id)
        self._presence.forget(move.object_id)
        self._forget(move.newcomer_id)
        return change

    def _forget(self, object_id: int) -> None:
        """An id that has become an alias, or that is known otherwise, leaves no evidence behind."""
        self._newcomers.discard(object_id)
        self._doubtful.discard(object_id)
        self._presence.forget(object_id)
        self._detector.forget(object_id)
        self._meshes.forget(object_id)
