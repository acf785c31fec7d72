"""An object that the tracker has just instantiated, as the map sees it among its anchors."""

from dataclasses import dataclass

import numpy as np

from neuse.geometry import Array
from neuse.mapping.evidence import AnchoredView
from neuse.mapping.object_record import ObjectRecord
from neuse.params import CheckedParams, param


@dataclass(frozen=True)
class NewcomerParams(CheckedParams):
    """When a newcomer is judged."""

    min_views: int = param(
        3, "keyframes with anchors that must have seen a newcomer before it is judged", 1, 1000
    )
    discovery_views: int = param(
        6, "keyframes after which a newcomer without evidence of change is a discovery", 1, 1000
    )
    min_empty_keyframes: int = param(
        3, "keyframes that must have seen a place empty before an object came or after it went", 1, 1000
    )
    max_evidence_keyframes: int = param(24, "earlier keyframes that are looked up for a newcomer", 1, 10000)
    min_shift_share: float = param(
        0.15, "share of an object's points that must be seen free where it was shifted, or displaced", 0.01, 1
    )
    same_place_m: float = param(0.03, "objects of like shape this near to each other are one, m", 0.0, 1.0)
    same_surface: float = param(
        2.0, "evidence (log likelihood ratio) of one object where no point of its place is seen free", 0, 100
    )
    exchange_s: float = param(
        1.0, "nothing takes the place of an object within this time of a sure sight of it, s", 0, 1e6
    )


@dataclass(frozen=True)
class Newcomer:
    """A newcomer and those of its views that were among anchors, oldest first."""

    record: ObjectRecord
    views: tuple[AnchoredView, ...]

    @property
    def tied_since(self) -> int:
        """Keyframes before that step tell nothing about its place."""
        return min(view.tied_since for view in self.views)

    @property
    def points(self) -> Array:
        """(n, 3) its surface points in all these views, map frame, drift taken out."""
        return np.concatenate([view.points for view in self.views])
