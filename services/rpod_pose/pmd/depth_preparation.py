"""Preparation of depth for the methods: the camera is checked, distances are unwrapped and calibrated.

A PMD camera measures the radial distance modulo c / 2f, with a systematic error. Methods should not have to
deal with either: ``PreparedTracker`` and ``PreparedAcquirer`` wrap a method and give it frames whose depth is
correct except for noise.

A distance is shifted by whole unambiguous ranges c / 2f only if the result lies in the target's bounding
sphere, so that background, glints and unwrapped distances do not change. The target's distance comes from the
prediction. Without a prediction it comes from the mean phase of the image, which leaves the multiple unknown.
Then the multiples at which the image has a possible size of the target are tried, nearest first: a wrong
multiple scales the target by half or more, which no pose explains. If the image shows more than the target,
its mean phase and size may be those of a wall, and all multiples are tried.

A target may be longer than the unambiguous range. Then some of its parts are measured too near, but still
inside the sphere. So the target is rendered at the prediction. A distance is shifted if its phases at all
frequencies agree with those of the rendered distance. A camera with several frequencies unwraps by itself,
but its distances have a limit too, which it does not state.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_geometry.kernels import kernel
from rpod_geometry.rays import cast
from rpod_pose.belief import MOST_SIGMA, MOST_SIGMA_DEG, undetermined
from rpod_pose.pmd.amplitude_unit import in_counts
from rpod_pose.pmd.camera_check import difference
from rpod_pose.pmd.depth_view import cosines_of, rays_if_any
from rpod_pose.pmd.other_things import PmdFrames
from rpod_pose.ports import Acquirer, Acquisition, Likelihoods, Outcome, Registration, Tracker
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator import PmdInput
from rpod_schemas.config.pmd.depth_calibration import DepthCalibration, unambiguous_range_m
from rpod_schemas.poses import rotation_matrix
from rpod_schemas.types import Float32Array, PmdFrame, Source
from rpod_target import Target

_LEAST_KNOWN, _UNKNOWN_DEG = math.sqrt(0.5), 180.0 / math.sqrt(3.0)
"""Largest standard deviation of a first pose, over that of an unknown pose of a target in view. Physics: the
frame then gives as much information as the knowledge that the target is in view. The second value is the
standard deviation of an unknown angle, deg; for a position the radius stands for it."""
_FARTHEST_M = 15.0
"""Largest distance of the target in a search without a prediction. Hand: from farther, too little light
returns."""
_MARGIN = 1.0 / 15.0
"""Margin around the target's bounding sphere for the error of a prediction, over the unambiguous range. Hand:
0.5 m at 20 MHz; twice the radius and this must stay below the unambiguous range."""
_MOST_MULTIPLES = 32
"""Largest number of multiples that a search tries. Numerics: a budget; a camera at 100 MHz needs up to 30."""
_LEAST_CONCENTRATION = 0.3
"""Least length of the mean phasor of an image that shows one distance; 0 for evenly spread distances, 1 for a
single one. Hand: with a smaller length the mean distance means nothing, and all multiples are tried."""
_SPREAD = (0.1, 0.75)
"""Least and greatest RMS spread of a target's image across the line of sight, over the target's radius.
Physics: a disc has 0.71; a thin body seen from its end has little."""
_LONGEST = 1.02
"""Largest distance that a camera without unwrapping states, over its unambiguous range. Hand: 2 % are for the
offset of a calibration and for rounding."""
_STEP_M, _END_M = 0.001, 30.0
"""Step and end of the table of corrections. Numerics: wiggling is linear over a millimetre. Physics: 5 MHz,
the lowest frequency in use, is unambiguous up to here."""
_ROUNDS = 40
"""Iterations of the inversion of a calibration. Numerics: each halves the error, whose slope is at most
0.5."""
_SAME = 1e-3
"""Largest relative difference of two equal frequencies. Hand: drivers round frequencies; two modes differ by
percents."""


class DepthPreparation:
    """Unwraps and calibrates the distances of a camera, by its configuration and the info in the frame.

    Args:
        sensor: configuration of the camera.
        target: the target, whose radius and distance field are used.
    """

    def __init__(self, sensor: PmdInput, target: Target) -> None:
        self._sensor, self.target = sensor, target
        self._corrections_m = corrections(sensor.calibration)

    def refusal(self, frame: PmdFrame) -> str:
        """Return why a frame is not that of the configured camera; empty if it is."""
        if self._sensor.camera is not None and (why := difference(frame.camera, self._sensor.camera)):
            return f"camera_info: {why} in the configuration"
        (name, first), *others = self._frequencies(frame) or [("", ())]
        for other, hertz in others:
            if len(hertz) != len(first) or not np.allclose(hertz, first, rtol=_SAME, atol=0.0):
                return f"modulation_frequency_hz: {name} says {_mhz(first)}, {other} says {_mhz(hertz)}"
        return ""

    def predicted(self, frame: PmdFrame, T_sensor_target: RigidTransform) -> PmdFrame:
        """Return a frame unwrapped around a predicted pose and calibrated."""
        frame, range_m = in_counts(frame), float(np.linalg.norm(T_sensor_target.translation))
        if self._is_longer(frame, range_m):
            frame = self._unwrapped_at(frame, T_sensor_target)
        return self._applied(frame, range_m, self.target.radius_m + _MARGIN * self._interval_m(frame))

    def possible(self, frame: PmdFrame) -> Iterator[PmdFrame]:
        """Yield a frame unwrapped to each possible multiple, nearest first, and calibrated.

        Multiples at which the whole image has a possible size of the target come first. If it shows more than
        the target at each of them, all others follow, in steps of half an unambiguous range. So one of them
        contains the whole target. At most ``_MOST_MULTIPLES`` are tried.
        """
        frame, interval_m, alone = in_counts(frame), self._interval_m(frame), False
        fitting_m = self._fitting_m(frame, interval_m)[:_MOST_MULTIPLES] if interval_m else [0.0]
        for distance_m in fitting_m:
            prepared = self._applied(frame, distance_m, 2.0 * self.target.radius_m)
            alone = alone or not interval_m or not self._shows_more(prepared)
            yield prepared
        if not alone:
            half_m, left = 0.5 * interval_m, max(_MOST_MULTIPLES - len(fitting_m), 1)
            for number in range(1, 1 + min(self._multiples(interval_m), left)):
                yield self._applied(frame, number * half_m, half_m)

    @staticmethod
    def _multiples(interval_m: float) -> int:
        """Return the number of steps of half an unambiguous range, m, up to the farthest target."""
        return max(math.ceil(_FARTHEST_M / (0.5 * interval_m)) - 1, 1)

    def untried(self, frame: PmdFrame) -> str:
        """Return that not all multiples are tried in a search, and the remedy; empty if all are."""
        interval_m = self._interval_m(frame)
        if not interval_m or self._multiples(interval_m) <= _MOST_MULTIPLES:
            return ""
        (name, hertz), *_ = self._frequencies(frame)
        of_it = f"{name} says {_mhz(hertz)}, whose unambiguous range is {interval_m:.2g} m"
        return f"{of_it}: only {_MOST_MULTIPLES} of its multiples are tried; is the frequency right?"

    def _fitting_m(self, frame: PmdFrame, interval_m: float) -> list[float]:
        """Return the distances at which the whole image has a possible size of the target, nearest first."""
        found = self._seen_at(frame)
        if found is None:
            return []
        range_m, spread = found
        ranges_m = np.arange(range_m, max(_FARTHEST_M, range_m + 1e-3), interval_m).tolist()
        least, most = (share * self.target.radius_m for share in _SPREAD)
        return [distance_m for distance_m in ranges_m if least <= spread * distance_m <= most]

    def _shows_more(self, frame: PmdFrame) -> bool:
        """Return whether a frame shows surfaces of a larger extent than the target's."""
        image = PmdFrames().image(frame, fine=False)
        return image is not None and image.shows_more_than(self.target.radius_m)

    def _is_longer(self, frame: PmdFrame, range_m: float) -> bool:
        """Return whether the target is so long that wrapped parts of it may lie in its bounding sphere."""
        known = self._frequencies(frame)
        if self._sensor.unwrapping == "none" or not known:
            return False
        farthest_m, radius_m = range_m + self.target.radius_m, self.target.radius_m
        longest_m = max(unambiguous_range_m(hertz) for hertz in known[0][1])
        if len(known[0][1]) > 1:  # a common multiple of several lengths is at least twice the longest
            return farthest_m > 2.0 * longest_m
        return farthest_m > longest_m and 2.0 * (radius_m + _MARGIN * longest_m) > longest_m

    def _unwrapped_at(self, frame: PmdFrame, T_sensor_target: RigidTransform) -> PmdFrame:
        """Return a frame whose distances are unwrapped by comparison with a rendering at a pose."""
        rays = rays_if_any(frame.camera)
        if rays is None:
            return frame  # the method reports the error of the lens
        closed, depth_m = self.target.field is not None, np.empty(frame.depth_m.shape, np.float32)
        hits = cast(rays, self.target.triangles_m, T_sensor_target, cull_back_faces=closed)
        intervals_m = np.array([unambiguous_range_m(hertz) for hertz in self._frequencies(frame)[0][1]])
        unwrap(frame.depth_m, rays.components[2], hits.range_m, intervals_m, depth_m)
        return frame.model_copy(update={"depth_m": depth_m})

    def _frequencies(self, frame: PmdFrame) -> list[tuple[str, tuple[float, ...]]]:
        """Return the sources of the modulation frequencies with their values; the first is used."""
        sensor, info, calibration = self._sensor, frame.info, self._sensor.calibration
        sources = (
            (f"{sensor.name}/info", tuple(info.modulation_frequency_hz) if info else ()),
            ("the configuration", sensor.modulation_frequency_hz),
            ("the calibration", calibration.modulation_frequency_hz if calibration else ()),
        )
        return [(name, hertz) for name, hertz in sources if hertz]

    def _interval_m(self, frame: PmdFrame) -> float:
        """Return the unambiguous range, m; 0 if nothing is to be unwrapped."""
        known = self._frequencies(frame)
        if self._sensor.unwrapping == "none" or not known:
            return 0.0
        _, hertz = known[0]
        return unambiguous_range_m(hertz[0]) if len(hertz) == 1 else 0.0

    def _seen_at(self, frame: PmdFrame) -> tuple[float, float] | None:
        """Return the mean distance modulo c / 2f, m, and the RMS spread of the slopes; None if unknown."""
        cosine = cosines_of(frame.camera)
        row, column = np.nonzero(np.isfinite(frame.depth_m) & (frame.depth_m > 0.0))
        if cosine is None or not row.size:
            return None
        interval_m = self._interval_m(frame)
        phase_rad = 2.0 * np.pi / interval_m * frame.depth_m[row, column] / cosine[row, column]
        mean = np.exp(1j * phase_rad).mean()
        if abs(mean) < _LEAST_CONCENTRATION:
            return None
        near = np.cos(phase_rad - np.angle(mean)) > 0.0
        spread = np.hypot(np.std(column[near]) / frame.camera.fx, np.std(row[near]) / frame.camera.fy)
        return float(np.angle(mean) % (2.0 * np.pi) / (2.0 * np.pi) * interval_m), float(spread)

    def observed(self, found: Registration) -> FloatArray:
        """Return a registration's covariance without variance about a free axis, which no frame observes."""
        if found.T_sensor_target is None:
            return found.covariance
        R = rotation_matrix(found.T_sensor_target)
        return self.target.equivalence.with_free_variance(found.covariance, R, 0.0)

    def _applied(self, frame: PmdFrame, range_m: float, reach_m: float) -> PmdFrame:
        cosine, interval_m = cosines_of(frame.camera), self._interval_m(frame)
        if cosine is None or (self._sensor.calibration is None and not interval_m):
            return frame  # the method reports the error of the lens
        depth_m = np.empty(frame.depth_m.shape, np.float32)
        _prepare(frame.depth_m, cosine, (range_m, reach_m, interval_m), self._corrections_m, depth_m)
        return frame.model_copy(update={"depth_m": depth_m})


class PreparedTracker:
    """A tracker that gets prepared frames: ports.Tracker[PmdFrame]."""

    def __init__(self, tracker: Tracker[PmdFrame], preparation: DepthPreparation) -> None:
        self._tracker, self._preparation = tracker, preparation

    def track(self, measurement: PmdFrame, T_sensor_target: RigidTransform) -> Registration:
        """Return the registration of the prepared frame; without a pose if the camera is another one."""
        if why := self._preparation.refusal(measurement):
            return Registration.none(Source.NONE, why)
        prepared = self._preparation.predicted(measurement, T_sensor_target)
        most_m = MOST_SIGMA * self._preparation.target.radius_m
        found = self._tracker.track(prepared, T_sensor_target)
        observed = self._preparation.observed(found)
        return _determined(found, observed, max_sigma_m=most_m, max_sigma_deg=MOST_SIGMA_DEG)


class PreparedAcquirer:
    """An acquirer that gets prepared frames: ports.Acquirer[PmdFrame]."""

    def __init__(self, acquirer: Acquirer[PmdFrame], preparation: DepthPreparation) -> None:
        self._acquirer, self._preparation = acquirer, preparation

    def acquire(self, measurement: PmdFrame) -> Acquisition:
        """Return the acquisition at the first multiple that shows the target; if none does, at the first."""
        if why := self._preparation.refusal(measurement):
            return _refused(why)
        failed: Acquisition | None = None
        for prepared in self._preparation.possible(measurement):
            found = self._acquirer.acquire(prepared)
            if found.outcome is not Outcome.FAILED:
                return self._determined(found)
            failed = failed or found
        assert failed is not None  # noqa: S101 - one is always possible
        return _telling(failed, self._preparation.untried(measurement))

    def near(self, measurement: PmdFrame, T_sensor_target: RigidTransform) -> Acquisition:
        """Return the acquisition near a pose, which determines the multiple."""
        if why := self._preparation.refusal(measurement):
            return _refused(why)
        prepared = self._preparation.predicted(measurement, T_sensor_target)
        return self._determined(self._acquirer.near(prepared, T_sensor_target))

    def _determined(self, found: Acquisition) -> Acquisition:
        """Return an acquisition whose belief says whether the frame determines position and attitude.

        If both ends of a long cylinder are outside the image, it fits at any place along its axis. Such a
        pose must not begin a track. Errors that a camera's frames share do not prevent a track, since they
        are the same in the next frame; the covariance contains them.
        """
        target = self._preparation.target
        if found.pose is None:
            return found
        registration = _determined(
            found.registration,
            self._preparation.observed(found.registration),
            max_sigma_m=_LEAST_KNOWN * target.radius_m,
            max_sigma_deg=_LEAST_KNOWN * _UNKNOWN_DEG,
        )
        return replace(found, registration=registration)


def prepared_likelihoods(likelihoods: Likelihoods, preparation: DepthPreparation) -> Likelihoods:
    """Return log likelihoods that prepare their frames; the first pose determines the multiple."""

    def prepared(frame: PmdFrame, found: Sequence[Registration], /) -> FloatArray:
        assert found[0].T_sensor_target is not None  # noqa: S101 - a rival has a pose
        return likelihoods(preparation.predicted(frame, found[0].T_sensor_target), found)

    return prepared


@kernel
def unwrap(
    depth_m: Float32Array, ray_z: Float32Array, shown_m: Float32Array, whole_m: FloatArray, out: Float32Array
) -> None:
    """Fill ``out`` with depth whose wrapped distances are shifted; all others keep their values.

    A wrapped distance is too short by whole unambiguous ranges ``whole_m`` of all frequencies, shape (F,).
    Depth, z of the unit rays, expected distance (not finite if unknown) and ``out``: shape (height, width).
    """
    depths, cosines, shown, shifted = depth_m.ravel(), ray_z.ravel(), shown_m.ravel(), out.ravel()
    for pixel in range(depths.size):
        depth, far_m, fits = depths[pixel], shown[pixel], True
        shifted[pixel], short_m = depth, far_m - depth / cosines[pixel]
        if not (far_m < np.inf and short_m > 0.5 * whole_m[0]):  # NaN is skipped too
            continue
        for each_m in whole_m:
            fits &= abs(short_m - each_m * np.rint(short_m / each_m)) <= _MARGIN * each_m
        if fits:
            shifted[pixel] = depth + whole_m[0] * np.rint(short_m / whole_m[0]) * cosines[pixel]


def corrections(calibration: DepthCalibration | None) -> Float32Array:
    """Return the table of measured minus true distance, m, for measured distances of 0 to 30 m, shape (N,).

    Its step is 1 mm of measured distance. Without a calibration it has the single entry 0.
    """
    if calibration is None:
        return np.zeros(1, np.float32)
    measured_m = np.arange(0.0, _END_M, _STEP_M)
    return (measured_m - calibrated(calibration, measured_m)).astype(np.float32)


def calibrated(calibration: DepthCalibration, measured_m: FloatArray) -> FloatArray:
    """Return the true radial distances t for measured ones m, any shape, as solutions of t = m - error(t)."""
    true_m = measured_m
    for _ in range(_ROUNDS):
        true_m = measured_m - calibration.error_m(true_m)
    return true_m


def _mhz(hertz: tuple[float, ...]) -> str:
    return " and ".join(f"{frequency / 1e6:g}" for frequency in hertz) + " MHz"


def _refused(why: str) -> Acquisition:
    return Acquisition(Registration.none(Source.NONE, why))


def _telling(failed: Acquisition, also: str) -> Acquisition:
    """Return a failed acquisition whose reason tells something else too, unless that is empty."""
    if not also:
        return failed
    belief = failed.registration.belief
    told = replace(belief, reason=f"{belief.reason}; {also}")
    return replace(failed, registration=replace(failed.registration, belief=told))


def _determined(
    registration: Registration, covariance: FloatArray, *, max_sigma_m: float, max_sigma_deg: float
) -> Registration:
    """Return a registration whose belief says whether the frame alone determines the pose well enough.

    A wall that fills the image fits any flat face of the target: such a pose must not begin a track.
    """
    if not registration.begins_track:
        return registration
    open_motion = undetermined(covariance, max_sigma_m=max_sigma_m, max_sigma_deg=max_sigma_deg)
    return replace(registration, belief=replace(registration.belief, undetermined=open_motion))


@kernel
def _prepare(
    depth_m: Float32Array,
    cosine: Float32Array,
    unwrapping: tuple[float, float, float],
    corrections_m: Float32Array,
    out_m: Float32Array,
) -> None:
    """Fill ``out_m`` with unwrapped and corrected depth; pixels without depth keep their values.

    Args:
        depth_m: z-depth, shape (height, width).
        cosine: z component of the pixels' unit rays, same shape.
        unwrapping: distance and radius of the sphere, and the unambiguous range (0 to unwrap nothing), m.
        corrections_m: correction to subtract from a distance, one for each ``_STEP_M``.
        out_m: output, same shape.
    """
    middle_m, radius_m, period_m = unwrapping
    turns_per_m = np.float32(1.0 / period_m if period_m > 0.0 else 0.0)
    range_m, reach_m, interval_m = np.float32(middle_m), np.float32(radius_m), np.float32(period_m)
    longest_m, nothing = interval_m * np.float32(_LONGEST), np.float32(0.0)
    steps_per_m, last = np.float32(1.0 / _STEP_M), np.float32(corrections_m.size - 1)
    depths, cosines, out = depth_m.ravel(), cosine.ravel(), out_m.ravel()
    for pixel in range(depths.size):
        depth = depths[pixel]
        if not nothing < depth < np.float32(np.inf):
            out[pixel] = depth
            continue
        measured_m, shift_m = depth / cosines[pixel], nothing
        if measured_m <= longest_m and abs(measured_m - range_m) > reach_m:
            shift_m = interval_m * np.rint((range_m - measured_m) * turns_per_m)
            if shift_m < nothing or abs(measured_m + shift_m - range_m) > reach_m:
                shift_m = nothing
        step = (measured_m + shift_m) * steps_per_m + np.float32(0.5)
        index = np.int32(step) if nothing <= step < last else np.int32(last)  # NaN takes the last entry
        shift_m -= corrections_m[index]
        ahead = measured_m + shift_m > nothing
        out[pixel] = depth + shift_m * cosines[pixel] if ahead else np.float32(np.nan)
