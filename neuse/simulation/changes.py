"""Changes between traversals: objects are added, removed, moved and swapped while out of sight."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from neuse.errors import ParamError
from neuse.geometry import Array
from neuse.records import ChangeKind
from neuse.simulation.layout import Decorator
from neuse.simulation.population import Item
from neuse.simulation.presets import ChangePlan
from neuse.simulation.scene import SceneChange, Timeline, TrueObject
from neuse.simulation.shapes import Shape

MIN_MOVE_M = 0.25
MAX_SWAP_M = 0.8


def change_scene(
    initial: Sequence[TrueObject],
    plans: Iterable[ChangePlan],
    new_items: Iterator[Item],
    decorator: Decorator,
) -> Timeline:
    """A timeline with the planned changes; no object changes twice.

    Args:
        new_items: shape and kind of pose of each object that is added.
    Raises:
        ParamError: too few objects are out of sight when a traversal begins, or there is no room.
    """
    director = _Director(initial, decorator)
    for plan in plans:
        director.frame = decorator.sight.trajectory.start_of(plan.traversal)
        for _ in range(plan.swapped_pairs):
            director.swap()
        for _ in range(plan.removed):
            director.remove()
        for _ in range(plan.moved):
            director.move()
        for _ in range(plan.added):
            director.add(*next(new_items))
    return Timeline(tuple(initial), tuple(director.changes))


class _Director:
    """Makes one change after the other, all at `frame`."""

    def __init__(self, initial: Sequence[TrueObject], decorator: Decorator) -> None:
        self.frame = 0
        self.changes: list[SceneChange] = []
        self._decorator = decorator
        self._objects = {true_object.object_id: true_object for true_object in initial}
        self._next_id = max(self._objects, default=-1) + 1

    def add(self, shape: Shape, kind: str) -> None:
        T_world_object = self._find_place(shape, kind, self._objects.values())
        self._apply(ChangeKind.ADDED, None, TrueObject(self._next_id, shape, T_world_object))
        self._next_id += 1

    def remove(self) -> None:
        self._apply(ChangeKind.REMOVED, self._candidates()[0], None)

    def move(self) -> None:
        before = self._candidates()[0]
        kind = "upright" if before.T_world_object[2, 2] > 0.9 else "lying"
        T_world_object = self._find_place(before.shape, kind, self._others(before), avoid=before.position)
        self._apply(ChangeKind.MOVED, before, replace(before, T_world_object=T_world_object))

    def swap(self) -> None:
        """Two objects of one category change places."""
        for first, second in combinations(self._candidates(), 2):
            first_after, second_after = _moved_to(first, second), _moved_to(second, first)
            others = self._others(first, second)
            if (
                _are_rivals(first, second)
                and self._decorator.fits(first_after, [*others, second_after])
                and self._decorator.fits(second_after, others)
            ):
                self._apply(ChangeKind.MOVED, first, first_after)
                self._apply(ChangeKind.MOVED, second, second_after)
                return
        raise ParamError(f"no two objects can swap places in frame {self.frame}; take more objects")

    def _apply(self, kind: ChangeKind, before: TrueObject | None, after: TrueObject | None) -> None:
        change = SceneChange(self.frame, kind, before, after)
        self.changes.append(change)
        self._objects.pop(change.subject.object_id, None)
        self._objects |= {after.object_id: after} if after else {}

    def _candidates(self) -> list[TrueObject]:
        """Objects that have not changed yet and are out of sight, in random order."""
        changed = {change.subject.object_id for change in self.changes}
        unchanged = [o for o in self._objects.values() if o.object_id not in changed]
        hidden = [o for o in unchanged if self._is_hidden(o.position)]
        if not hidden:
            raise ParamError(f"no unchanged object is out of sight in frame {self.frame}; plan fewer changes")
        return [hidden[i] for i in self._decorator.rng.permutation(len(hidden))]

    def _find_place(
        self, shape: Shape, kind: str, others: Iterable[TrueObject], avoid: Array | None = None
    ) -> Array:
        def suits(T_world_object: Array) -> bool:
            position = T_world_object[:3, 3]
            far = avoid is None or bool(np.linalg.norm(position - avoid) >= MIN_MOVE_M)
            return far and self._is_hidden(position)

        return self._decorator.find_place(shape, kind, self._decorator.tables, list(others), suits)

    def _is_hidden(self, position: Array) -> bool:
        return self._decorator.sight.is_hidden(position, self.frame)

    def _others(self, *excluded: TrueObject) -> list[TrueObject]:
        ids = {true_object.object_id for true_object in excluded}
        return [true_object for true_object in self._objects.values() if true_object.object_id not in ids]


def _are_rivals(first: TrueObject, second: TrueObject) -> bool:
    """Whether two objects are worth swapping: of one category but not one shape, and not far apart."""
    alike = first.shape.category == second.shape.category and first.shape is not second.shape
    return alike and bool(MIN_MOVE_M < np.linalg.norm(first.position - second.position) < MAX_SWAP_M)


def _moved_to(moved: TrueObject, other: TrueObject) -> TrueObject:
    """An object at the place of another on a table of the same height, upright or lying as before."""
    T_world_object = moved.T_world_object.copy()
    T_world_object[:2, 3] = other.position[:2]
    return replace(moved, T_world_object=T_world_object)
