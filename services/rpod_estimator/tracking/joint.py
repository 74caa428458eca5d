"""Tracking in depth and amplitude at once: signed distance of the points, places of the edges.

A prediction that has the edges in their places needs the last, narrow steps only: a wider search may take one
for its neighbour, and where there is little depth that draws the pose away first. One that has most of them
near needs a few wider steps before; one that explains the depth fairly all of them; any other is first drawn
in on depth alone, which needs no edge to be near its place. Where the result is in doubt, for depth may agree
before the attitude does, the wider start is tried too. The self-check asks both images: with a wrong camera
matrix, another target or a mirrored image the depth may agree, the edges do not. Where one image says
nothing, the other goes on alone, and the source says so.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import radians

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from rpod_estimator.ports import Registration
from rpod_estimator.tracking.amplitude_noise import noise_of, noise_of_change, typical_of
from rpod_estimator.tracking.depth_view import PLUMB_BOB, DepthView
from rpod_estimator.tracking.edge_model import EdgeModel
from rpod_estimator.tracking.frame_check import Contradictions, contradictions
from rpod_estimator.tracking.joint_fit import agreement, align, coarse_ranges, in_place
from rpod_estimator.tracking.joint_verdict import edge_doubt, edges_in_place, scale_doubt
from rpod_estimator.tracking.rendering import Rendering
from rpod_estimator.tracking.scan_alignment import draw_in
from rpod_estimator.tracking.signed_distance import field_arrays
from rpod_estimator.tracking.surface_model import SurfaceModel
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd_joint import JointConfig
from rpod_schemas.poses import pose_of
from rpod_schemas.types import Camera, PmdFrame, Source
from rpod_sim_sensor.geometry import DistortionError, Hits, cast_pose
from rpod_target import Target

MARGIN_PX = 16
"""Around the target's sphere."""
FILLED = 0.4
"""Share of the square around its sphere that a target typically fills."""
STRIDES_PX = 3, 8
"""Least and greatest distance of two points in the image."""
SPARSE = 4
"""Every how many pixels the image's mean is taken from, and depth is counted."""
MIN_PATCH = 3
"""Rows and columns of which edges can be told."""
WIDER = 2.0
"""Times the reach of the last search: whether edges are in their places asks so far for others."""
LIT_SHARE = 0.25
"""Of the median amplitude: darker pixels do not tell the noise."""
CHANGE_SIGMAS = 3.0
"""Of the noise: a lesser change of amplitude does not count as an edge."""
_NO_PATCH = np.zeros((1, 1), np.float32), np.zeros(2), 1.0, 0.0
_Patch = tuple[NDArray[np.float32], FloatArray, float, float]


@dataclass(frozen=True, eq=False)
class _Seen:
    """One frame as the kernels take it."""

    view: DepthView
    range_m: FloatArray
    """Of the coarse pixels, shape (rows, columns), NaN for none."""
    sigma_m: FloatArray
    """Standard deviation of their noise, same shape."""
    shade: FloatArray
    """Their amplitude, same shape; 0 where a glint wiped it out, NaN where there is none."""
    typical: float
    """Median amplitude of the pixels with depth; 0 where these are too few."""
    points_m: FloatArray
    """Sensor axes, shape (N, 3)."""
    trust: FloatArray
    """Weight of each point, 0 to 1: less for one that is dark for the frame's noise, shape (N,)."""
    patch: _Patch
    """Smoothed amplitude around the target, column and row of its first pixel, change that counts, and the
    noise of a change."""


class JointTracker:
    """Registers PMD frames: ports.Tracker[PmdFrame].

    Args:
        config: its parameters.
        target: what to look for.
        calibrated: whether the depth is, so that less of it is doubted.

    Raises:
        rpod_target.TargetError: the target has no distance field.
    """

    def __init__(self, config: JointConfig, target: Target, *, calibrated: bool = False) -> None:
        self._config, self._target = config, target
        self._ranges = config.depth.calibrated if calibrated else config.depth.raw
        edges = EdgeModel.of(target, spacing_m=config.edges.spacing_share * target.radius_m)
        self._model = np.ascontiguousarray(target.triangles_m), field_arrays(target), edges.arrays
        weak = np.repeat((config.unobserved_m, radians(config.unobserved_deg)), 3)
        self._weak = np.diag(np.append(weak**-2, 0.0))
        scales_m = np.geomspace(config.depth.scale_m, config.depth.final_scale_m, config.iterations)
        reaches_px = np.geomspace(config.edges.search_px, config.edges.final_search_px, config.iterations)
        coarse = np.column_stack((scales_m, reaches_px))
        self._sharp = np.tile(coarse[-1], (config.near_iterations, 1))
        self._near = np.vstack((coarse[-config.near_iterations :], self._sharp))
        self._fair = np.vstack((coarse, self._sharp))
        self._far = np.geomspace(config.far_scale_m, config.depth.scale_m, config.far_iterations)
        self._coarse = SurfaceModel.of(target).coarse_field
        self._buffers: dict[tuple[int, int], Hits] = {}

    def track(self, measurement: PmdFrame, T_sensor_target: RigidTransform) -> Registration:
        """Return the registration from a predicted pose, or the reason why there is none."""
        matrix = T_sensor_target.as_matrix()
        R, t = matrix[:3, :3].copy(), matrix[:3, 3].copy()
        seen = self._see(measurement, t)
        if isinstance(seen, str):
            return Registration(Source.PMD_JOINT, reason=seen)
        registration = Registration(Source.PMD_JOINT, reason="nothing to see")
        for start in self._starts(seen, R, t):
            registration = self._registered(seen, *start)
            if not registration.reason:
                break
        return registration

    def _starts(
        self, seen: _Seen, R: FloatArray, t: FloatArray
    ) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
        """Yield poses to start from and the steps to do there, the fewest that may do first."""
        config = self._config
        share, in_place = self._explained(seen, R, t), self._in_place(seen, R, t)
        if in_place >= config.near_share:
            yield R, t, self._sharp if in_place >= config.sharp_share else self._near
        if share >= config.fair_share or len(seen.points_m) < config.verdict.min_points:
            yield R, t, self._fair
        if len(seen.points_m) >= config.verdict.min_points:
            every = max(1, round(len(seen.points_m) / config.far_points))
            few_m = np.ascontiguousarray(seen.points_m[::every])
            yield *draw_in(few_m, R, t, self._coarse, self._far), self._fair

    def _registered(self, seen: _Seen, R: FloatArray, t: FloatArray, schedule: FloatArray) -> Registration:
        config, view = self._config, seen.view
        R, t, information, points, squares, edges, asked, expected, bias = align(
            seen.points_m,
            seen.trust,
            R,
            t,
            self._model,
            seen.patch,
            (view.coarse.arrays, (view.stride, view.offset), _lens(view)),
            schedule,
            (
                config.depth.noise_m,
                float(config.depth.effective_points),
                self._ranges.bias_m,
                self._ranges.uneven_m,
                config.slack_m,
            ),
            (config.edges.sigma_px, float(config.edges.effective_edges)),
            self._buffers_of(view),
        )
        if points < config.verdict.min_points and asked < config.verdict.min_edges:
            reason = f"nothing to see: {points} points on the target, {asked} places of edges"
            return Registration(Source.PMD_JOINT, reason=reason)
        contrary = self._contradictions(seen, R, t, bias)
        in_place = edges_in_place(
            config.verdict, edges=edges, expected=expected, asked=asked, points=len(seen.points_m)
        )
        reason = self._verdict(contrary, in_place, bias_m=bias, range_m=float(np.linalg.norm(t)))
        to_sensor = np.zeros((6, 6))
        to_sensor[:3, :3] = to_sensor[3:, 3:] = R
        covariance = np.linalg.inv(information + self._weak)[:6, :6]
        return Registration(
            self._source(points, asked),
            T_sensor_target=pose_of(R, t),
            reason=reason,
            contradicted=bool(reason) or in_place < config.verdict.weak_edge_share,
            judged=True,
            cost_m2=squares / max(points, 1),
            inliers=points + edges,
            inlier_share=(points + edges) / max(len(seen.points_m) + asked, 1),
            explained_share=contrary.explained_share,
            covariance=to_sensor @ covariance @ to_sensor.T,
            iterations=len(schedule),
        )

    def _explained(self, seen: _Seen, R: FloatArray, t: FloatArray) -> float:
        """Return the share of the pixels that agree with a predicted pose."""
        agreeing, asked = agreement(
            seen.range_m,
            seen.sigma_m,
            seen.view.coarse.arrays,
            self._model[0],
            R,
            t,
            self._config.near_m,
            self._config.missing_weight,
            self._buffers_of(seen.view),
        )
        return agreeing / asked if asked else 0.0

    def _in_place(self, seen: _Seen, R: FloatArray, t: FloatArray) -> float:
        """Return the share of the edges that lie where a predicted pose, as rendered, has them."""
        config, view = self._config, seen.view
        agreeing, expected, asked = in_place(
            self._model[2],
            R,
            t,
            _lens(view),
            (view.stride, view.offset),
            self._buffers_of(view)[0],
            seen.patch,
            WIDER * config.edges.final_search_px,
            config.edges.sigma_px,
        )
        return agreeing / max(expected, 1.0) if asked >= config.verdict.min_edges else 0.0

    def _contradictions(self, seen: _Seen, R: FloatArray, t: FloatArray, bias_m: float) -> Contradictions:
        view, buffers = seen.view, self._buffers_of(seen.view)
        cast_pose(view.coarse.arrays, self._model[0], R, t, True, *buffers)
        rendered = Rendering(*buffers, view.coarse, view.stride, view.camera.fx, self._model[0], R, t)
        images = seen.range_m, seen.sigma_m, seen.shade
        return contradictions(images, rendered, self._config.check, typical=seen.typical, bias_m=bias_m)

    def _source(self, points: int, edges: int) -> Source:
        if edges < self._config.verdict.min_edges:
            return Source.PMD_DEPTH
        return Source.PMD_JOINT if points >= self._config.verdict.min_points else Source.PMD_AMPLITUDE

    def _verdict(self, contrary: Contradictions, in_place: float, *, bias_m: float, range_m: float) -> str:
        """Return why a pose is not believed, empty if it is."""
        limits, sigma_m = self._config.verdict, self._ranges.bias_m
        return (
            contrary.doubt(self._config.check)
            or edge_doubt(limits, in_place)
            or scale_doubt(limits, bias_m=bias_m, sigma_m=sigma_m, range_m=range_m)
        )

    def _buffers_of(self, view: DepthView) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        shape = view.coarse.shape
        if shape not in self._buffers:
            self._buffers[shape] = Hits.of(view.coarse)
        return self._buffers[shape].range_m, self._buffers[shape].triangle

    def _see(self, frame: PmdFrame, t: FloatArray) -> _Seen | str:
        config = self._config
        if frame.camera.distortion[PLUMB_BOB:].any():
            return f"distortion has {len(frame.camera.distortion)} coefficients, plumb_bob has {PLUMB_BOB}"
        try:
            view = DepthView.of(frame.camera, self._stride(frame, t))
        except DistortionError as error:
            return str(error)
        amplitude = np.ones_like(frame.depth_m) if frame.amplitude is None else frame.amplitude
        sparse = slice(None, None, SPARSE)
        lit = np.where(frame.depth_m[sparse, sparse] > 0.0, amplitude[sparse, sparse], 0.0)
        least = config.ghost_share * float(lit.mean())
        range_m, sigma_m, strengths, shade = coarse_ranges(
            frame.depth_m, amplitude, least, view.coarse.components[2], view.stride, view.offset
        )
        range_m[sigma_m > config.check.most_noise_m] = np.nan
        measured = np.flatnonzero(np.isfinite(range_m))
        if len(measured) > config.depth.points:
            measured = measured[np.linspace(0, len(measured) - 1, config.depth.points).astype(np.intp)]
        rays = view.coarse.components.reshape(3, -1)[:, measured]
        points_m = np.ascontiguousarray((rays * range_m.ravel()[measured]).T)
        strength = strengths.ravel()[measured]
        typical = float(np.median(strength)) if len(measured) else 1.0
        trust = self._trust(sigma_m.ravel()[measured], strength)
        typical = typical if len(measured) >= config.verdict.min_points else 0.0
        patch = _NO_PATCH
        if frame.amplitude is None:
            shade[:] = np.nan
        else:
            patch = self._patch(frame, t, typical)
        return _Seen(view, range_m, sigma_m, shade, typical, points_m, trust, patch)

    def _trust(self, sigma_m: FloatArray, strength: FloatArray) -> FloatArray:
        """Return the weight of points: what else is wrong with a range, over that and its noise, squared.

        Noise goes by one over the amplitude; each point's own is told too badly by its few pixels.
        """
        scale_m = float(np.median(sigma_m * strength)) if len(strength) else 0.0
        return 1.0 / (1.0 + (scale_m / (self._config.depth.noise_m * np.maximum(strength, 1e-9))) ** 2)

    def _stride(self, frame: PmdFrame, t: FloatArray) -> int:
        """Return every how many pixels what depth the target has holds the points wanted."""
        camera = frame.camera
        radius_px = camera.fx * self._target.radius_m / max(t[2], 1e-3)
        pixels = min(camera.width, 2.0 * radius_px) * min(camera.height, 2.0 * radius_px) * FILLED
        rows, columns = self._around(camera, t)
        sparse = frame.depth_m[rows, columns][::SPARSE, ::SPARSE]
        pixels = min(pixels, SPARSE**2 * np.count_nonzero(sparse > 0.0))
        return int(np.clip(np.sqrt(pixels / self._config.depth.points), *STRIDES_PX))

    def _around(self, camera: Camera, t: FloatArray) -> tuple[slice, slice]:
        """Return the rows and columns around the target's sphere; all where it is close."""
        if t[2] <= 2.0 * self._target.radius_m:
            return slice(0, camera.height), slice(0, camera.width)
        radius = self._target.radius_m / (t[2] - self._target.radius_m)
        column, row = camera.fx * t[0] / t[2] + camera.cx, camera.fy * t[1] / t[2] + camera.cy
        across, down = camera.fx * radius + MARGIN_PX, camera.fy * radius + MARGIN_PX
        return (
            slice(max(int(row - down), 0), min(int(row + down), camera.height)),
            slice(max(int(column - across), 0), min(int(column + across), camera.width)),
        )

    def _patch(self, frame: PmdFrame, t: FloatArray, typical: float) -> _Patch:
        """Return the smoothed amplitude around the target, its first pixel, a change's least and noise.

        What is typical where depth is left is a start only: that may be on the dark parts alone.
        """
        config = self._config.edges
        assert frame.amplitude is not None  # noqa: S101 - told by the caller
        rows, columns = self._around(frame.camera, t)
        part = np.nan_to_num(frame.amplitude[rows, columns].astype(np.float32))
        if min(part.shape) < MIN_PATCH:
            return _NO_PATCH
        typical = typical_of(part, typical or float(np.median(part[part >= part.mean()])))
        if typical <= 0.0:
            return _NO_PATCH
        noise = noise_of_change(config.blur_px) * noise_of(part, LIT_SHARE * typical)
        np.minimum(part, config.clip * typical, out=part)
        smooth: NDArray[np.float32] = cv2.GaussianBlur(part, (0, 0), config.blur_px)  # type: ignore[assignment]
        least = max(config.least_contrast * typical, CHANGE_SIGMAS * noise)
        return smooth, np.array((columns.start, rows.start), float), least, noise


def _lens(view: DepthView) -> FloatArray:
    camera = view.camera
    return np.array((camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion))
