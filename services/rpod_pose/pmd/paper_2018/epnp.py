"""The 2018 paper's second technique: lines and a circle of the amplitude image, corners, EPnP.

Klionovska et al., Robotics 7(1), 2018, section 3.3: the wireframe is projected with the prior pose, and each
of its lines is matched with the nearest Hough line. Neighbouring lines intersect in corners, the nose's
circle gives a seventh point, and EPnP gives the pose (Eqs. 5 to 7). Two steps are added to the paper's: the
search is repeated with narrower limits around the resulting pose, so that the first search may be wide, and
the pose is refined to the least reprojection error.

Points that do not determine a pose are rejected with a reason: fewer than four points, corners of one plane
without the nose, points that are inconsistent with each other, or a pose far from the prediction.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_geometry.errors import DistortionError
from rpod_geometry.rays import NEAREST_M
from rpod_pose.pmd.depth_view import DepthView
from rpod_pose.pmd.paper_2018.edge_image import EdgeImage, edge_image
from rpod_pose.pmd.paper_2018.edge_lines import ImageLine, Reach, intersection, matched_line
from rpod_pose.pmd.paper_2018.nose_circle import DiscPlane, circle_centre
from rpod_pose.pmd.paper_2018.perspective import Correspondences, Fit, pose_from_points
from rpod_pose.pmd.paper_2018.wireframe_view import Shown, WireframeView
from rpod_pose.ports import Registration
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd.amplitude import EpnpConfig
from rpod_schemas.config.pmd.lengths import relative_size
from rpod_schemas.poses import pose_error
from rpod_schemas.types import Camera, PmdFrame, Source
from rpod_target import Target

STRIDE_PX = 4
"""Stride of the pixels on which the model is rendered to find what is hidden. Numerics: a budget of
computation."""
FARTHEST_RADII = 200.0
"""Largest distance of a target with visible lines, in its radii. Numerics: lines are then a few pixels long
or shorter."""
LEAST_ANGLE_RAD, LEAST_REACH_PX, LEAST_TOLERANCE = np.deg2rad(6.0), 2.5, 0.06
"""Least limits of the matches. Hand: short lines and small circles are not more accurate."""


@dataclass(frozen=True)
class Search:
    """Limits of the search for features in one round."""

    lines: Reach
    circle_m: float
    """Largest distance of a circle's centre from its prediction, on its plane."""
    tolerance: float
    """Largest difference of a circle's radius from its prediction, as a share of it."""
    first: bool
    """Whether circles are found by the Hough transform; later rounds measure them at the known pose."""

    @classmethod
    def of(cls, config: EpnpConfig, *, number: int, px_per_m: float, size: float) -> "Search":
        """Return the search of a round, numbered from 0.

        Args:
            config: limits of the first round.
            number: the round.
            px_per_m: scale at the target's distance.
            size: size of what is seen, relative to the mock-up.
        """
        width = config.lines.narrowing**number
        lines_m, circle_m = config.reaches_m(size)
        reach_px = max(lines_m * width * px_per_m, LEAST_REACH_PX)
        return cls(
            Reach(max(np.deg2rad(config.lines.angle_deg) * width, LEAST_ANGLE_RAD), reach_px),
            circle_m=max(circle_m * width, LEAST_REACH_PX / px_per_m),
            tolerance=max(config.circle.radius_tolerance * width, LEAST_TOLERANCE),
            first=number == 0,
        )


class EpnpTracker:
    """Registers amplitude images by corners, a circle and EPnP: ports.Tracker[PmdFrame]."""

    def __init__(self, config: EpnpConfig, target: Target) -> None:
        self._config, self._radius_m = config, target.radius_m
        self._farthest_m = FARTHEST_RADII * target.radius_m
        self._view = WireframeView(
            target,
            only_front=config.points == "front",
            min_face_share=config.min_face_share,
            min_seen_share=config.lines.min_seen_share,
        )

    def track(self, measurement: PmdFrame, T_sensor_target: RigidTransform) -> Registration:
        """Return the registration from a predicted pose, or the reason why the frame gives none."""
        image = edge_image(measurement, self._config.edges)
        if isinstance(image, str):
            return _refused(image)
        try:
            view = DepthView.of(measurement.camera, STRIDE_PX)
        except DistortionError as error:
            return _refused(str(error))
        pose, fits = T_sensor_target, list[Fit]()
        for number in range(self._config.rounds):
            points = self._found(image, view, pose, number)
            fit = points if isinstance(points, str) else self._fit(points, image.camera)
            if isinstance(fit, str):
                return _refused(fit)
            pose = fit.T_sensor_target
            fits.append(fit)
        return self._registered(fits[-1], T_sensor_target, image.camera)

    def _found(
        self, image: EdgeImage, view: DepthView, T_sensor_target: RigidTransform, number: int
    ) -> Correspondences | str:
        """Return the corners and centres found around a pose, or the reason why there are none."""
        if not NEAREST_M < T_sensor_target.translation[2] < self._farthest_m:
            return "the target is not in front of the camera"
        shown = self._view.shown(T_sensor_target, view)
        if isinstance(shown, str):
            return shown
        range_m = float(T_sensor_target.translation[2])
        size, px_per_m = relative_size(self._radius_m, range_m), image.camera.fx / range_m
        search = Search.of(self._config, number=number, px_per_m=px_per_m, size=size)
        corners = self._corners(image, shown, T_sensor_target, search)
        centres = self._centres(image, shown, T_sensor_target, search)
        found = corners + centres
        return Correspondences(
            np.array([point_m for point_m, _ in found]).reshape(-1, 3),
            np.array([place for _, place in found]).reshape(-1, 2),
        )

    def _corners(
        self, image: EdgeImage, shown: Shown, T_sensor_target: RigidTransform, search: Search
    ) -> list[tuple[FloatArray, FloatArray]]:
        """Return corners of the model, target axes, with their pixels: intersections of image lines."""
        config, wireframe = self._config.lines, self._view.wireframe
        corners_m = T_sensor_target.apply(wireframe.corners_m)
        corners_m[:, 2] = np.maximum(corners_m[:, 2], NEAREST_M)
        projected = image.project(corners_m)
        meeting: dict[int, list[ImageLine]] = {}
        for ends, silhouette in zip(wireframe.lines[shown.lines], shown.silhouette.tolist(), strict=True):
            edges = image.edges(silhouette=silhouette)
            line = matched_line(edges, projected[ends], reach=search.lines, config=config)
            if line is not None:
                for corner in ends.tolist():
                    meeting.setdefault(corner, []).append(line)
        found: list[tuple[FloatArray, FloatArray]] = []
        for corner, lines in sorted(meeting.items()):
            place = intersection(lines, min_turn_rad=np.deg2rad(config.min_turn_deg))
            if (
                place is not None
                and np.linalg.norm(place - projected[corner]) < 2.0 * search.lines.distance_px
            ):
                found.append((wireframe.corners_m[corner], place))
        return found

    def _centres(
        self, image: EdgeImage, shown: Shown, T_sensor_target: RigidTransform, search: Search
    ) -> list[tuple[FloatArray, FloatArray]]:
        """Return centres of the model's circles, target axes, with their pixels in the image."""
        found: list[tuple[FloatArray, FloatArray]] = []
        for disc in shown.discs:
            place = circle_centre(
                DiscPlane.of(image, disc, T_sensor_target),
                reach=search.circle_m / disc.radius_m,
                tolerance=search.tolerance,
                config=self._config.circle,
                canny_high=self._config.edges.canny_high if search.first else None,
            )
            if place is not None:
                found.append((disc.centre_m, place))
        return found

    def _fit(self, points: Correspondences, camera: Camera) -> Fit | str:
        """Return the pose of points after the removal of outliers one by one, or why there is none."""
        config = self._config
        while True:
            if len(points) < config.min_points:
                return f"{len(points)} corners and circles found, {config.min_points} needed"
            if points.relief < config.min_relief:
                return f"{len(points)} points lie nearly in one plane: the tilt is ambiguous"
            fit = pose_from_points(points, camera, iterations=config.polish_iterations)
            if fit is None:
                return "EPnP found no pose in front of the camera"
            distances_px = fit.distances_px
            if distances_px.max() <= config.outlier_px or len(points) == config.min_points:
                break
            points = points.without(int(distances_px.argmax()))
        if fit.rms_px > config.max_error_px:
            return f"reprojection error {fit.rms_px:.1f} px, limit {config.max_error_px:.1f} px"
        return fit

    def _registered(self, fit: Fit, T_predicted: RigidTransform, camera: Camera) -> Registration:
        """Return the registration of the last round's pose, or the reason why it is rejected."""
        pose = fit.T_sensor_target
        covariance = fit.covariance(self._config.noise_px)
        reason = self._refusal(pose, T_predicted, covariance)
        if reason:
            return _refused(reason)
        return Registration(
            Source.PMD_AMPLITUDE,
            pose,
            cost_m2=(fit.rms_px * pose.translation[2] / camera.fx) ** 2,
            inliers=len(fit.errors_px),
            covariance=covariance,
            iterations=self._config.rounds,
        )

    def _refusal(self, pose: RigidTransform, T_predicted: RigidTransform, covariance: FloatArray) -> str:
        config = self._config
        attitude_rad, shift_m = pose_error(T_predicted, pose)
        turn_deg = float(np.rad2deg(np.linalg.norm(attitude_rad)))
        shift = float(np.linalg.norm(shift_m) / np.linalg.norm(T_predicted.translation))
        if not np.isfinite(covariance).all():
            return "degenerate: the points leave a motion undetermined"
        sigma_deg = float(np.rad2deg(np.sqrt(np.linalg.eigvalsh(covariance[3:, 3:])[-1])))
        demands = (
            (
                sigma_deg <= config.max_sigma_deg,
                f"attitude known to {sigma_deg:.1f} deg, limit {config.max_sigma_deg:.1f} deg",
            ),
            (
                turn_deg <= config.max_turn_deg,
                f"turned {turn_deg:.1f} deg from the prediction, limit {config.max_turn_deg:.1f} deg",
            ),
            (
                shift <= config.max_shift_share,
                f"shifted from the prediction by {shift:.0%} of the distance, "
                f"limit {config.max_shift_share:.0%}",
            ),
        )
        return next((reason for met, reason in demands if not met), "")


def _refused(reason: str) -> Registration:
    return Registration.none(Source.PMD_AMPLITUDE, reason)
