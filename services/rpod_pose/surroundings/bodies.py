"""Known bodies beside the target, such as the arm that holds it: surfaces, and poses at a frame's stamp.

A ray on such a body gives no information on the target. So the body is neither taken for the target nor a
contradiction, and it hides things behind it.
"""

from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from rpod_geometry.rays import cast
from rpod_pose.errors import PoseError
from rpod_pose.surroundings.body_check import BodyBook, Place, sighting
from rpod_pose.surroundings.separation import NEIGHBOURS, RangeImage
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.surroundings import KnownBody
from rpod_schemas.poses import between, chained
from rpod_schemas.topics import CHASER
from rpod_target.mesh.folder import surface_m
from rpod_target.mesh.topology import unit_normals

LONGEST_GAP_S = 0.1
"""Longest time from the newest reading for which the pose of a body is known. Physics: an arm that moves with
0.3 m/s and 3 m/s2 is then 15 mm off its extrapolated position."""
KEPT_S = 10.0
"""Time for which readings are kept. Numerics: memory; frames are not older."""


class KnownBodiesError(PoseError):
    """A known body cannot be used."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A known body, in the frame in which its pose is given."""

    name: str
    frame: str
    triangles_m: FloatArray
    """Corners, shape (T, 3, 3)."""
    normals: FloatArray
    """Unit normals, shape (T, 3)."""
    tolerance_m: float

    @classmethod
    def of(cls, name: str, body: KnownBody, folder: Path) -> Self:
        """Return a body; its file is relative to a folder. Raises ``KnownBodiesError``."""
        try:
            corners_m = surface_m(folder / body.file, body.metres_per_unit)
        except (OSError, ValueError) as error:
            raise KnownBodiesError(f"body {name}: {folder / body.file}: {error}") from error
        moved = body.pose.apply(corners_m.reshape(-1, 3)).reshape(corners_m.shape)
        triangles_m = np.ascontiguousarray(moved)
        return cls(name, body.frame, triangles_m, unit_normals(triangles_m), body.tolerance_m)


class FrameTrack:
    """Poses of a frame in ``chaser``, in the order of their stamps.

    A pose does not depend on readings after its stamp, so that it is the same in a live run and in a replay.
    It is extrapolated from the last two readings up to the stamp.
    """

    def __init__(self) -> None:
        self._stamps_ns: list[int] = []
        self._poses: list[RigidTransform] = []

    def take(self, stamp_ns: int, T_chaser_frame: RigidTransform) -> bool:
        """Add a reading and return True; if it is not newer than all before, ignore it and return False."""
        if self._stamps_ns and stamp_ns <= self._stamps_ns[-1]:
            return False
        self._stamps_ns.append(stamp_ns)
        self._poses.append(T_chaser_frame)
        if self._stamps_ns[0] < stamp_ns - 2e9 * KEPT_S:
            first = bisect_right(self._stamps_ns, stamp_ns - round(1e9 * KEPT_S))
            del self._stamps_ns[:first], self._poses[:first]
        return True

    def forget(self) -> None:
        """Forget all readings, for example after a clock was set back."""
        self._stamps_ns.clear()
        self._poses.clear()

    def covers(self, stamp_ns: int) -> bool:
        """Return whether all readings up to a stamp have arrived, if their period stays the same."""
        if len(self._stamps_ns) < 2:
            return False
        return 2 * self._stamps_ns[-1] - self._stamps_ns[-2] > stamp_ns

    def at(self, stamp_ns: int) -> RigidTransform | None:
        """Return T_chaser_frame at a stamp; None if no reading is near it."""
        place = bisect_right(self._stamps_ns, stamp_ns)
        if not place or stamp_ns - self._stamps_ns[place - 1] > 1e9 * LONGEST_GAP_S:
            return None
        newest_ns, newest = self._stamps_ns[place - 1], self._poses[place - 1]
        if place < 2 or newest_ns - self._stamps_ns[place - 2] > 1e9 * LONGEST_GAP_S:
            return newest
        before_ns = self._stamps_ns[place - 2]
        return between(self._poses[place - 2], newest, (stamp_ns - before_ns) / (newest_ns - before_ns))


class KnownBodies:
    """The known bodies of a laboratory.

    Args:
        surfaces: the bodies, each with the frame in which its pose is given.
    """

    def __init__(self, surfaces: tuple[Surface, ...]) -> None:
        self._surfaces = surfaces
        frames = sorted({surface.frame for surface in surfaces} - {CHASER})
        self.tracks: dict[str, FrameTrack] = {frame: FrameTrack() for frame in frames}
        """Readings of the frames that move, by name."""
        self.book = BodyBook()
        """States of the bodies, as the frames show them."""

    @classmethod
    def of(cls, bodies: Mapping[str, KnownBody], folder: Path) -> Self | None:
        """Return the bodies of a file; None for none. Raises ``KnownBodiesError``."""
        if not bodies:
            return None
        return cls(tuple(Surface.of(name, body, folder) for name, body in bodies.items()))

    def unknown(self, stamp_ns: int) -> tuple[str, ...]:
        """Return the frames whose pose at a stamp is not known."""
        return tuple(frame for frame, track in self.tracks.items() if track.at(stamp_ns) is None)

    def hiding(
        self, image: RangeImage, stamp_ns: int, T_chaser_sensor: RigidTransform, sensor: str = ""
    ) -> NDArray[np.bool_]:
        """Return the rays on which a known body may hide the target, shape (rows, columns).

        The state of each body in the frame is noted in ``book``. A body that the sensor sees at another place
        hides nothing: the frame is used as if the body were unknown.

        Args:
            image: ranges of a frame.
            stamp_ns: stamp of the frame.
            T_chaser_sensor: mount of the sensor.
            sensor: its name.
        """
        hides = np.zeros(image.range_m.shape, np.bool_)
        axes = T_chaser_sensor.rotation.as_matrix()
        for surface in self._surfaces:
            moved = self.tracks[surface.frame].at(stamp_ns) if surface.frame != CHASER else None
            if surface.frame != CHASER and moved is None:
                continue
            T_sensor_chaser = T_chaser_sensor.inv()
            pose = T_sensor_chaser if moved is None else chained(T_sensor_chaser, moved)
            place = placed(image, surface, pose)
            if place is not None and self.book.take(sensor, sighting(surface.name, image, place), axes):
                hides |= _hidden_by(image, place)
        return hides


def placed(image: RangeImage, surface: Surface, pose: RigidTransform) -> Place | None:
    """Return a body rendered at its pose in a frame; None if no ray meets it."""
    hits = cast(image.grid, surface.triangles_m, pose)
    rendered_m, met = hits.range_m, hits.triangle >= 0
    if not met.any():
        return None
    tolerance_m = surface.tolerance_m
    reach = image.rays_across(tolerance_m, float(rendered_m[met].min()))
    shape = reach.around
    tolerance = np.float32(tolerance_m)
    nearest_m = cv2.erode(rendered_m, shape, borderValue=np.inf) - tolerance
    farthest_m = cv2.dilate(np.where(met, rendered_m, np.float32(0.0)), shape) + tolerance
    cosine = np.zeros(met.shape)
    normals = pose.rotation.apply(surface.normals[hits.triangle[met]])
    cosine[met] = np.abs((normals * image.grid.directions[met]).sum(axis=1))
    return Place(rendered_m, nearest_m, farthest_m, cosine, tolerance_m, reach)


def _hidden_by(image: RangeImage, place: Place) -> NDArray[np.bool_]:
    """Return the rays on a body: those that end at its surface, and those that must have met it.

    The surface may be off by its tolerance in each direction. Pixels beside these rays show a mixture of the
    body and of things next to it, so that their ranges belong to neither.
    """
    met = np.isfinite(place.rendered_m)
    shape = place.reach.around
    around, surely = (change(met.view(np.uint8), shape).view(np.bool_) for change in (cv2.dilate, cv2.erode))
    measured = image.range_m > 0.0
    before = measured & (image.range_m < place.nearest_m)
    beyond = measured & (image.range_m > place.farthest_m) & ~surely
    on_body = around & ~before & ~beyond
    if max(place.reach) == 1:  # rays are farther apart than the tolerance: each sees one surface
        return on_body
    beside = cv2.dilate(on_body.view(np.uint8), NEIGHBOURS).view(np.bool_)
    hidden: NDArray[np.bool_] = on_body | (beside & ~before)
    return hidden
