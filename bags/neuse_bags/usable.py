"""What the front end would use of the frames of a bag, decided by itself, with networks that do nothing."""

from collections import Counter
from collections.abc import Collection, Sequence

import numpy as np

from neuse.embedding.code import Code
from neuse.embedding.observe import Observer
from neuse.records import RgbdFrame

REMEDIES = {
    "empty_mask": "give the pixels of each instance its label",
    "label_without_instance": "list each label of the mask among the instances",
    "mask_too_large": "label the objects alone, 0 is background",
    "too_few_points": "send depth where the objects are, in metres or 16UC1 millimetres",
}
TOLD_ELSEWHERE = {"unknown_category"}


class _NoNetwork:
    """Stands in for an embedding: its codes say nothing, and are sound."""

    def __init__(self, category: str) -> None:
        self.category = category

    def encode(self, clouds: Sequence[np.ndarray], share: float = 1.0) -> list[Code]:
        """A code at the middle of each cloud."""
        middles = (np.tile(cloud.mean(axis=0), (8, 1)) for cloud in clouds)
        return [Code(self.category, False, z, np.full(8, 8**-0.5), np.full(6, 0.1)) for z in middles]


class UsableCheck:
    """Counts the instances that can be used, and why the others cannot."""

    def __init__(self, categories: Collection[str]) -> None:
        """categories: those that there are weights for."""
        self._observer = Observer(embeddings={name: _NoNetwork(name) for name in categories})  # type: ignore[misc]
        self._reasons: Counter[str] = Counter()
        self._details: dict[str, str] = {}
        self.n_usable = 0

    def add(self, frame: RgbdFrame) -> None:
        """Take in one frame.

        Raises:
            InputError: the frame as a whole cannot be used.
        """
        observed = self._observer.observe(frame)
        self.n_usable += len(observed.observations)
        for rejection in observed.rejections:
            if rejection.reason not in TOLD_ELSEWHERE:
                self._reasons[rejection.reason] += 1
                self._details.setdefault(rejection.reason, rejection.detail)

    def refused(self) -> str | None:
        """Counts by reason with an example and the way out of each; None where nothing was refused."""
        told = (
            f"{count} x {reason} ({self._details[reason]}; {REMEDIES.get(reason, 'see docs/masks.md')})"
            for reason, count in self._reasons.most_common()
        )
        return ", ".join(told) or None
