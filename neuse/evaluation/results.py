"""Figures of one variant on one world, computed once: a JSON file each, so that a stopped run goes on."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from neuse.evaluation.comparison import OTHERS
from neuse.evaluation.comparison import SOURCES as OTHER_SOURCES
from neuse.evaluation.encoded_world import SOURCES, EncodedWorld, encoded_world, fingerprint
from neuse.evaluation.estimate import Estimate
from neuse.evaluation.evaluation import evaluate
from neuse.evaluation.nees import Nees, edge_error, nees_by_objects, pose_nees
from neuse.evaluation.report import report_dict, write_json
from neuse.evaluation.run import run_encoded
from neuse.evaluation.trajectory import Trajectory
from neuse.evaluation.variants import params_of
from neuse.records import Edge, EdgeKind

Result = dict[str, Any]

SCORING = ("changes", "evaluation", "nees", "objects", "pose_errors", "report", "results", "run", "variants")
RUN_SOURCES = (*SOURCES, "slam", "mapping", "pipeline.py", *(f"evaluation/{module}.py" for module in SCORING))
WRONG_RAD, WRONG_M = np.deg2rad(10.0), 0.10  # a loop closure further off is wrong


class Results:
    """Results by variant, preset and seed under one folder; what is missing is computed when asked for.

    frames: only so many first frames of each world; None for all.    first_seed: where the seeds begin.
    """

    def __init__(self, folder: Path, frames: int | None = None, first_seed: int = 0) -> None:
        self.folder, self._frames, self._first_seed = folder, frames, first_seed
        self._stamp = fingerprint(RUN_SOURCES)

    def get(self, variant: str, preset: str, seed: int) -> Result:
        """The figures of one run: those of report.json, and `trust`."""
        length = self._frames or "all"
        path = self.folder / "results" / variant / f"{preset}-{seed}-{length}-{self._stamp}.json"
        if not path.exists():
            world = encoded_world(preset, seed, self.folder / "worlds", self._frames)
            print(f"run {variant} on {world.name}", flush=True)
            result = figures(world, run_encoded(world, params_of(variant)))
            path.parent.mkdir(parents=True, exist_ok=True)
            write_json(path, result)
        return json.loads(path.read_text())

    def over_seeds(self, variant: str, preset: str, seeds: int) -> list[Result]:
        """The results of so many seeds, from the first one on."""
        first = self._first_seed
        return [self.get(variant, preset, seed) for seed in range(first, first + seeds)]

    def of_nodes(self, preset: str) -> Result | None:
        """report.json of the three nodes on the preset's first world; None if they were not run."""
        path = self.folder / "nodes" / f"{preset}-{self._first_seed}" / "report.json"
        return json.loads(path.read_text()) if path.exists() else None

    def others_over_seeds(self, name: str, preset: str, seeds: int) -> list[Result]:
        """What others make of the same worlds: the figures of comparison.OTHERS."""
        first = self._first_seed
        return [self._other(name, preset, seed) for seed in range(first, first + seeds)]

    def _other(self, name: str, preset: str, seed: int) -> Result:
        stamp = fingerprint((*RUN_SOURCES, *OTHER_SOURCES))
        path = self.folder / "results" / name / f"{preset}-{seed}-{self._frames or 'all'}-{stamp}.json"
        if not path.exists():
            worlds = self.folder / "worlds"
            world = encoded_world(preset, seed, worlds, self._frames)
            print(f"run {name} on {world.name}", flush=True)
            result = OTHERS[name](world, worlds)
            path.parent.mkdir(parents=True, exist_ok=True)
            write_json(path, result)
        return json.loads(path.read_text())


def figures(world: EncodedWorld, estimate: Estimate) -> Result:
    """All figures of a run."""
    truth = world.truth.trajectory
    closures = [edge for edge in estimate.edges if edge.kind == EdgeKind.LOOP_CLOSURE]
    return report_dict(estimate, evaluate(estimate, world.truth)) | {
        "trust": {
            "poses": _as_dict(pose_nees(estimate.frames, truth)),
            **{
                f"{kind.name.lower()}/{objects}": _as_dict(nees)
                for kind in (EdgeKind.SHORT_RANGE, EdgeKind.LOOP_CLOSURE)
                for objects, nees in nees_by_objects(
                    [edge for edge in estimate.edges if edge.kind == kind], estimate.categories, truth
                ).items()
            },
        },
        "wrong_closures": sum(is_wrong(edge, truth) for edge in closures),
    }


def is_wrong(edge: Edge, truth: Trajectory) -> bool:
    """Whether an edge is off by more than WRONG_RAD or WRONG_M."""
    xi = edge_error(edge, truth)
    return xi is not None and bool(np.linalg.norm(xi[:3]) > WRONG_RAD or np.linalg.norm(xi[3:]) > WRONG_M)


def _as_dict(nees: Nees | None) -> dict[str, Any] | None:
    return asdict(nees) if nees else None
