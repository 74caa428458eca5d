"""Check for pixels of a frame that are inconsistent with a pose: coarse first, then in two finer steps.

The last step corrects the wiggling of a camera that is not calibrated. Its modulation is not exactly a sine.
With four samples a period, the harmonics cause an error of the range whose period is an eighth of the
modulation's wavelength, c / (8 f) (M. Lindner et al., Computer Vision and Image Understanding 114, 2010). Its
phase and amplitude differ from camera to camera. The errors at the near and the far end of a target may
differ by centimetres.
"""

from functools import partial

import cv2
import numpy as np
from scipy.constants import speed_of_light

from rpod_geometry.rays import Hits, RenderBuffers
from rpod_pose.pmd.joint.brightness.patch_renderer import PatchRenderer
from rpod_pose.pmd.joint.check.bright_beyond import unsupported
from rpod_pose.pmd.joint.check.frame_check import BRIGHT, Contradictions, SeenPixels, contradictions
from rpod_pose.pmd.joint.check.reflections import reflected_m
from rpod_pose.pmd.joint.fit import Measured, agreement
from rpod_pose.pmd.joint.frame import JointFrame
from rpod_pose.pmd.rendering import FineRanges, Rendering
from rpod_pose.ports import Registration
from rpod_pose.registration.lie_group import PoseArrays
from rpod_pose.registration.surface_model import cast_faces
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd.joint import JointTuning, RangeErrorConfig
from rpod_schemas.types import PmdFrame
from rpod_target import Target

PERIODS = 8.0
"""Number of periods of the error in one wavelength of the modulation; the light travels twice the range.
Physics: four samples alias the third and the fifth harmonic to four periods in half a wavelength."""
NEIGHBOURS = np.ones((3, 3), np.uint8)
"""A pixel and those around it. Physics: 3 x 3."""
ROUNDS = 3
"""Number of weighted fits; each reduces the weights of outliers. Numerics: a budget of computation."""


class PixelCheck:
    """Finds the pixels of a frame that are inconsistent with a pose.

    Args:
        target: the target.
        tuning: limits.
        ranges: errors of the camera's ranges.
        renderer: renders the target with more rays.
    """

    def __init__(
        self, target: Target, tuning: JointTuning, ranges: RangeErrorConfig, renderer: PatchRenderer
    ) -> None:
        self._radius_m, self._faces = target.radius_m, renderer.faces
        self._tuning, self._limits, self._ranges, self._renderer = tuning, tuning.check, ranges, renderer
        self._near_m = max(tuning.near_depth_share * target.radius_m, ranges.bias_m)
        self._missing_weight = tuning.missing_weight
        self._reflected_m = reflected_m(target)

    def contradictions(
        self, seen: JointFrame, pose: PoseArrays, bias_m: float, buffers: RenderBuffers
    ) -> Contradictions:
        """Return the pixels that are inconsistent with a pose.

        If there are too many, the pose is rendered with more rays. If there are still too many, the ranges
        are corrected by the wiggling that explains them best.

        Args:
            seen: the frame.
            pose: pose of the target.
            bias_m: length by which all ranges are too long.
            buffers: buffers for the rendered coarse pixels.
        """
        view, limits, (R, t) = seen.view, self._limits, pose
        cast_faces(view.coarse.arrays, self._faces, R, t, buffers)
        images = SeenPixels(seen.range_m, seen.sigma_m, seen.shade)
        coarse = Rendering(*buffers, view.coarse, view.stride, view.camera.fx, self._faces.triangles_m, R, t)
        check = partial(
            contradictions,
            radius_m=self._radius_m,
            typical=seen.typical,
            uneven_m=self._ranges.uneven_m,
            bias_m=bias_m,
            reflected_m=self._reflected_m,
        )
        found = check(images, coarse, limits)
        if found.reason(limits) and seen.patch.typical:
            check = partial(check, fine=self._fine_ranges(seen, pose))
            found = check(images, coarse, limits)
        if found.reason(limits) and len(seen.frequencies_hz):
            range_m = seen.range_m - self._wiggling(seen, buffers, bias_m)
            found = check(images._replace(range_m=range_m), coarse, limits)
        return found

    def explained(self, seen: JointFrame, pose: PoseArrays, buffers: RenderBuffers) -> float:
        """Return the share of the checked pixels that agree with a predicted pose.

        Args:
            seen: the frame.
            pose: pose of the target.
            buffers: buffers for the rendered coarse pixels.
        """
        measured = Measured(seen.range_m, seen.sigma_m, self._near_m, self._missing_weight)
        agreeing, checked = agreement(measured, seen.view.coarse.arrays, self._faces, pose, buffers)
        return agreeing / checked if checked else 0.0

    def by_extent(self, frame: PmdFrame, found: Registration) -> Registration:
        """Return a registration by depth alone, contradicted if ranges of the target's surface are missing.

        Args:
            frame: the frame, with its amplitude.
            found: a registration with a pose.
        """
        assert found.T_sensor_target is not None  # noqa: S101 - as the description says
        pose = PoseArrays.of(found.T_sensor_target)
        seen = JointFrame.of(frame, pose.t, radius_m=self._radius_m, tuning=self._tuning)
        return found if isinstance(seen, str) else unsupported(found, self.unranged(seen, pose), self._limits)

    def unranged(self, seen: JointFrame, pose: PoseArrays) -> Contradictions:
        """Return the pixels inside a pose's surface that have no range although they are bright enough.

        A pixel that is brighter than half of those with a range would have one, if it showed the target. Such
        pixels tell a smaller body before something bright that has no ranges.
        """
        rendered = Hits.of(seen.view.coarse).arrays
        cast_faces(seen.view.coarse.arrays, self._faces, pose.R, pose.t, rendered)
        ranged = seen.every_range_m > 0.0
        inside = cv2.erode((rendered.triangle >= 0).view(np.uint8), NEIGHBOURS, borderValue=0).view(bool)
        bright = (seen.typical < seen.shade) & (seen.shade < BRIGHT[1] * seen.typical)
        missing = inside & bright & ~ranged
        side = self._limits.patch_px
        around = cv2.boxFilter(missing.view(np.uint8), cv2.CV_16U, (side, side), normalize=False)
        checked, most = int(np.count_nonzero(inside & (bright | ranged))), int(around.max(initial=0))
        return Contradictions(checked, int(np.count_nonzero(missing)), most, 0, missing)

    def _wiggling(self, seen: JointFrame, shown: RenderBuffers, bias_m: float) -> FloatArray:
        """Return the wiggling of the coarse pixels, shape (rows, columns), m; 0 if it is unknown."""
        range_m, owner = shown
        both = np.isfinite(seen.range_m) & (owner >= 0)
        measured_m = seen.range_m[both]
        found_m = np.zeros(seen.range_m.shape)
        found_m[both] = wiggling(
            measured_m - bias_m - range_m[both],
            measured_m,
            seen.frequencies_hz,
            sigma_m=self._ranges.bias_m,
            scale_m=max(self._ranges.uneven_m, seen.noise_m),
        )
        return found_m

    def _fine_ranges(self, seen: JointFrame, pose: PoseArrays) -> FineRanges:
        """Return the ranges of the patch's rays at a pose."""
        n, offset = seen.per_px, seen.view.offset
        row, column = (n * (offset - int(first)) + n // 2 for first in (seen.patch.row, seen.patch.column))
        return FineRanges(self._renderer.cast(seen.rays, pose).range_m, n, row, column)


def wiggling(
    error_m: FloatArray, range_m: FloatArray, frequencies_hz: FloatArray, *, sigma_m: float, scale_m: float
) -> FloatArray:
    """Return the wiggling that explains errors of ranges best, without their common offset, shape (N,), m.

    The amplitudes have a prior, so that the wiggling is not larger than that of a real camera.

    Args:
        error_m: measured ranges less those expected, shape (N,), m.
        range_m: measured ranges, shape (N,), m.
        frequencies_hz: modulation frequencies, shape (F,), Hz; without any, the result is 0.
        sigma_m: standard deviation of the camera's wiggling, m.
        scale_m: Geman-McClure scale of the errors that remain after the wiggling, m.
    """
    if not len(error_m) or not len(frequencies_hz) or sigma_m == 0.0:
        return np.zeros(len(error_m))
    phase = 2.0 * np.pi * PERIODS / speed_of_light * np.outer(range_m, frequencies_hz)
    waves = np.column_stack((np.ones(len(range_m)), np.sin(phase), np.cos(phase)))
    prior = np.full(waves.shape[1], (scale_m / sigma_m) ** 2)
    prior[0] = 0.0
    weights, amplitudes = np.ones(len(error_m)), np.zeros(waves.shape[1])
    for _ in range(ROUNDS):
        weighted = waves * weights[:, None]
        amplitudes = np.linalg.lstsq(weighted.T @ waves + np.diag(prior), weighted.T @ error_m, rcond=None)[0]
        left_m = error_m - waves @ amplitudes
        weights = (1.0 + (left_m / scale_m) ** 2) ** -2
    explained: FloatArray = waves[:, 1:] @ amplitudes[1:]
    return explained - np.median(explained)
