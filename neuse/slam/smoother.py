"""iSAM2 over a graph to which factors and vertices come, and from which they go."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np

from neuse.errors import SolverError
from neuse.geometry import Array
from neuse.params import CheckedParams, param
from neuse.slam.factors import BIAS, LOOSE_POINT, POINT, POSE, VELOCITY, solver_errors
from neuse.slam.relinearization import Relinearization

LOOSE_FACTOR = 10.0  # loose points may move so much further before they are relinearised
LINEAR = {VELOCITY: np.full(3, 1e9), BIAS: np.full(6, 1e9)}  # thresholds of what need not be relinearised
NOT_BY_ITSELF = 2**31 - 1  # solutions between relinearisations that nobody has asked for
FAST, SAFE = "CHOLESKY", "QR"  # factorisations; the second can do where the first finds sigmas too far apart


@dataclass(frozen=True)
class SolverParams(CheckedParams):
    """How the graph is solved."""

    cauchy_sigmas: float = param(
        3.0, "scale of the Cauchy kernel on sightings and external edges, sigmas", 0.1, 100.0
    )
    huber_sigmas: float = param(3.0, "threshold of the Huber kernel on edges, sigmas", 0.1, 100.0)
    relinearize_m: float = param(0.01, "iSAM2 relinearises what moved more than this, m", 1e-6, 1.0)
    relinearize_rad: float = param(0.003, "iSAM2 relinearises what turned more than this, rad", 1e-6, 1.0)
    relinearize_every: int = param(5, "solutions between two relinearisations", 1, 1000)
    relinearize_most: int = param(
        500, "vertices relinearised in one solution; after a loop closure the others follow", 1, 10**9
    )
    acceleration_mps2: float = param(
        0.3,
        "the camera moves smoothly: white noise of its acceleration, m/s^2/sqrt(Hz); 0: it may jerk",
        0.0,
        1e3,
    )
    window_iterations: int = param(20, "most Levenberg-Marquardt iterations in the window", 1, 100)


class Smoother:
    """Factors and start values wait for the next solution; what is no more part of the graph goes with it."""

    def __init__(self, params: SolverParams) -> None:
        self.params = params
        self.isam = gtsam.ISAM2(_isam_params(params, FAST))
        thresholds = _thresholds(params)
        self._relinearization = Relinearization(thresholds, params.relinearize_every, params.relinearize_most)
        self._new_factors, self._new_values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        self._leaving: set[int] = set()

    @property
    def is_behind(self) -> bool:
        """Whether the last solution has left a part to the next."""
        return self._relinearization.is_behind

    def add(self, factor: gtsam.NonlinearFactor) -> None:
        """One more factor."""
        self._new_factors.add(factor)

    def insert(self, key: int, value: Any) -> None:
        """A new vertex with its start value."""
        self._new_values.insert(key, value)

    def remove(self, keys: Iterable[int]) -> None:
        """Vertices of the solved graph go, and with them all factors that say something of them."""
        self._leaving.update(keys)

    def solve(self) -> None:
        """Take in what was added and update the estimates.

        Raises:
            SolverError: the graph leaves something open; only a new graph helps.
        """
        try:
            self._update()
        except SolverError:
            known, waiting = self.isam.getLinearizationPoint(), (self._new_factors, self._new_values)
            taken_in = all(known.exists(key) for key in self._new_values.keys())  # noqa: SIM118
            self.begin_anew(known, SAFE)
            if not taken_in:
                self._new_factors.push_back(waiting[0])
                self._new_values.insert(waiting[1])
            self._update()

    def begin_anew(self, values: gtsam.Values, factorization: str, without: tuple[type, ...] = ()) -> None:
        """The same graph with other start values waits for its solution; factors of some types are gone."""
        factors, self._new_factors = self.isam.getFactorsUnsafe(), gtsam.NonlinearFactorGraph()
        for factor in (factors.at(i) for i in range(factors.size()) if factors.exists(i)):
            if not isinstance(factor, without) and self._leaving.isdisjoint(factor.keys()):
                self._new_factors.add(factor)
        self._new_values = gtsam.Values(values)
        for key in filter(values.exists, self._leaving):
            self._new_values.erase(key)
        self._leaving.clear()
        self.isam = gtsam.ISAM2(_isam_params(self.params, factorization))

    def _update(self) -> None:
        with solver_errors():
            update = self._relinearization.next_update(self.isam)
            update.removeFactorIndices = self._leaving_factors()
            self.isam.update(self._new_factors, self._new_values, update)
        self._new_factors, self._new_values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        self._leaving.clear()

    def _leaving_factors(self) -> list[int]:
        """Places of the factors of all vertices that leave; without factors a vertex is gone."""
        if not self._leaving:
            return []
        factors_of = self.isam.getVariableIndex()
        present = [key for key in self._leaving if self.isam.valueExists(key)]
        return sorted({index for key in present for index in factors_of.at(key)})


def _isam_params(params: SolverParams, factorization: str) -> gtsam.ISAM2Params:
    isam_params = gtsam.ISAM2Params()
    isam_params.setRelinearizeThreshold(_threshold_map(_thresholds(params) | LINEAR))
    isam_params.relinearizeSkip = NOT_BY_ITSELF
    isam_params.findUnusedFactorSlots = True
    isam_params.setFactorization(factorization)
    return isam_params


def _thresholds(params: SolverParams) -> dict[str, Array]:
    """By the character of the keys, for each coordinate how far it may move."""
    rad, m = np.full(3, params.relinearize_rad), np.full(3, params.relinearize_m)
    return {
        POSE: np.concatenate([rad, m]),
        POINT: m,
        LOOSE_POINT: LOOSE_FACTOR * m,
    }


def _threshold_map(thresholds: Mapping[str, Array]) -> gtsam.ISAM2ThresholdMap:
    thresholds_by_kind = gtsam.ISAM2ThresholdMap()
    for kind, least in thresholds.items():
        thresholds_by_kind.insert((kind, least))
    return thresholds_by_kind
