"""When a session is believed to stand somewhere in a map: once it is found there again and again."""

from collections.abc import Sequence

import numpy as np

from neuse.geometry import Array, adjoint, inverse, rotation_angle
from neuse.slam.prior_map import PriorMap
from neuse.slam.relocalization import Place, RelocalizationParams, find_place
from neuse.slam.track import Track

SAME_POSE_M, SAME_POSE_RAD = 0.05, 0.05


class Relocalizer:
    """Looks for a session's place in a map, and believes it when it is found several times in a row."""

    def __init__(self, params: RelocalizationParams | None = None) -> None:
        self.params = params or RelocalizationParams()
        self._last: Place | None = None
        self._times = 0

    def look(self, tracks: Sequence[Track], prior: PriorMap, T_session_camera: Array) -> Place | None:
        """The session's place, once it is certain.

        tracks: of the session, the last seen first.    T_session_camera: (4, 4) where the camera is now.
        """
        place = find_place(tracks, prior, self.params)
        again = place is not None and self._is_as_before(place, T_session_camera)
        self._times = self._times + 1 if again else 0 if place is None else 1
        self._last = place
        if place is None or self._times < self.params.confirmations:
            return None
        return place if self._is_precise(place, T_session_camera) else None

    def _is_precise(self, place: Place, T_session_camera: Array) -> bool:
        """Whether it tells where the camera is: few objects in one line, or far away, hardly do."""
        A = adjoint(inverse(T_session_camera))
        variances = np.diag(A @ place.covariance @ A.T)
        sigma_rad, sigma_m = np.sqrt([variances[:3].sum(), variances[3:].sum()])
        return bool(sigma_m <= self.params.max_sigma_m and sigma_rad <= self.params.max_sigma_rad)

    def forget(self) -> None:
        """Begin anew."""
        self._last, self._times = None, 0

    def _is_as_before(self, place: Place, T_session_camera: Array) -> bool:
        """Whether it puts the camera where the last one did."""
        if self._last is None:
            return False
        T_before_now = inverse(self._last.T_map_session @ T_session_camera) @ (
            place.T_map_session @ T_session_camera
        )
        near = np.linalg.norm(T_before_now[:3, 3]) <= SAME_POSE_M
        return bool(near and rotation_angle(T_before_now[:3, :3]) <= SAME_POSE_RAD)
