"""One run against ground truth: trajectory, changes, objects and covariances."""

import logging
from dataclasses import dataclass

from neuse.errors import DegenerateGeometryError
from neuse.evaluation.changes import ChangeScore, score_changes
from neuse.evaluation.estimate import Estimate
from neuse.evaluation.nees import Nees, summarize_nees
from neuse.evaluation.objects import ObjectScore, score_objects
from neuse.evaluation.pose_errors import TrajectoryErrors, trajectory_errors
from neuse.evaluation.trajectory import Trajectory
from neuse.evaluation.truth import Truth
from neuse.geometry import Array
from neuse.records import EdgeKind

OBJECT_EDGES = (EdgeKind.SHORT_RANGE, EdgeKind.LOOP_CLOSURE)

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Evaluation:
    """Scores of one run.

    trajectory: final poses.    online: poses as published at the time.
    traversals: final poses, each traversal aligned by itself; None where one is too short to align.
    nees: by edge kind; "all" is over short-range and loop-closure edges.
    """

    trajectory: TrajectoryErrors
    online: TrajectoryErrors
    traversals: tuple[TrajectoryErrors | None, ...]
    changes: ChangeScore
    objects: ObjectScore
    nees: dict[str, Nees | None]

    @property
    def T_world_map(self) -> Array:
        """Alignment of the final trajectory; places in the map are compared with the world through it."""
        return self.trajectory.T_world_map


def evaluate(estimate: Estimate, truth: Truth) -> Evaluation:
    """Score a run.

    The map frame and the world are related by the SE(3) alignment of the whole final trajectory.

    Raises:
        DegenerateGeometryError: the trajectory cannot be aligned with ground truth.
    """
    final = estimate.trajectory()
    errors = trajectory_errors(final, truth.trajectory)
    traversals = [final.between(start, end) for start, end in truth.traversals()]
    return Evaluation(
        trajectory=errors,
        online=trajectory_errors(estimate.online_trajectory(), truth.trajectory),
        traversals=tuple(_errors_or_none(part, truth) for part in traversals),
        changes=score_changes(estimate.changes, truth.changes, errors.T_world_map),
        objects=score_objects(estimate.final_map().objects, truth.final_objects(), errors.T_world_map),
        nees=_nees_by_kind(estimate, truth),
    )


def _errors_or_none(part: Trajectory, truth: Truth) -> TrajectoryErrors | None:
    try:
        return trajectory_errors(part, truth.trajectory)
    except DegenerateGeometryError as error:
        _log.warning("a traversal is left out of the per-traversal errors: %s", error)
        return None


def _nees_by_kind(estimate: Estimate, truth: Truth) -> dict[str, Nees | None]:
    groups = {"all": OBJECT_EDGES, **{kind.name.lower(): (kind,) for kind in EdgeKind}}
    return {name: summarize_nees(estimate.edges, truth.trajectory, kinds) for name, kinds in groups.items()}
