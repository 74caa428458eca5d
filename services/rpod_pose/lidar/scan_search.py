"""The search in one scan: from thousands of attitudes to a few poses, ranked by likelihood."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import cos, radians
from typing import Self

import numpy as np
from numpy.typing import NDArray

from rpod_pose.belief import Belief
from rpod_pose.lidar.return_distances import ReturnDistances
from rpod_pose.lidar.scan_alignment import FaceProblem, ScanErrors, settle
from rpod_pose.lidar.scan_fit import ScanFit, ScanModel
from rpod_pose.lidar.scan_view import ScanView, SeenScan
from rpod_pose.registration.field_alignment import Points, field_aligned
from rpod_pose.registration.lie_group import PoseArrays
from rpod_pose.registration.surface_model import SurfaceModel
from rpod_pose.search.energy import NOTHING_IN_VIEW, energies
from rpod_pose.search.turns import FEW_RETURNS, MORE_RETURNS, Turns
from rpod_pose.search.view_model import ViewModel, centroids_in_view
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.lidar_search import GlobalSearchConfig, SearchLevelConfig
from rpod_schemas.types import Float32Array

DRAW_IN_SCALES_M = 1.0, 0.15
"""Of the first and the last step that draws a candidate onto the scan."""
SETTLE_SCALES_M = np.array([0.5, 0.3, 0.2])
"""Of a candidate's steps to the faces."""
FINE_SCALES_M = np.array([0.2, 0.1, 0.1])
"""Of the steps that the best ones are finished with."""
HALFWAY = 4.0
"""Deficit a return, above none, of a pose that the outline may yet make right."""
GAIN = 5.0
"""Log likelihood by which a pose is worth being turned again."""
OPEN_M, OPEN_RAD = 0.3, 0.1
"""Standard deviations within which the outline is searched for what the faces leave open."""
STRETCH = 1.5
"""Of the standard deviations of what the faces tell, within which it is searched too: a few returns may be on
the wrong ones."""


@dataclass(frozen=True, eq=False)
class Pose:
    """A pose of the target in the sensor, and how well it explains the scan."""

    R: FloatArray
    t: FloatArray
    fit: ScanFit
    information: FloatArray
    """About (dtau, dtheta) of ``normal_equations``, shape (6, 6)."""


@dataclass(frozen=True, eq=False)
class Scanner:
    """The rays of every few rows and columns of a pattern, and what is expected of them."""

    view: ScanView
    distances: ReturnDistances
    statistics: ScanModel

    @classmethod
    def of(
        cls, view: ScanView, config: GlobalSearchConfig, surface: SurfaceModel, *, sigma_range_m: float
    ) -> Self:
        """Return the scanner of a view; the sigma of a range is what the sensor says, 0 where it does not."""
        model, verdict = config.tracking.model, config.tracking.verdict
        statistics = ScanModel(model, verdict, view, surface, sigma_range_m=sigma_range_m)
        return cls(view, ReturnDistances.of(view), statistics)


@dataclass(frozen=True, eq=False)
class Model:
    """The target in the three forms that the search needs."""

    views: ViewModel
    surface: SurfaceModel
    turns: Turns


class ScanSearch:
    """Searches one scan."""

    def __init__(self, config: GlobalSearchConfig, model: Model, scanner: Scanner, seen: SeenScan) -> None:
        self._config, self._model, self._scanner, self.seen = config, model, scanner, seen
        self._image = scanner.distances.image(seen)
        self._centroid_m = seen.points_m.mean(axis=0)
        self._few = Points.equal(seen.thinned(config.draw_in_points))
        self._far_m = np.geomspace(*DRAW_IN_SCALES_M, config.draw_in_steps)

    def search(self, attitudes: Float32Array, level: SearchLevelConfig) -> list[Pose]:
        """Return distinct poses, likeliest first; empty where no attitude shows the target to the sensor.

        Args:
            attitudes: R_sensor_target to begin with, shape (M, 3, 3).
            level: how many of them are followed.
        """
        found: list[Pose] = []
        for R, t in self._candidates(attitudes, level):
            found.append(self._drawn_in(R, t))
            if self._is_sure(found[-1]):
                return self.completed(found, siblings=1)
        return self.completed(found, siblings=self._config.siblings)

    def completed(self, found: list[Pose], *, siblings: int) -> list[Pose]:
        """Return distinct poses, likeliest first: those found, and what they may be mistaken for.

        The best of them, ``siblings`` of their number, have all been turned.
        """
        config, turned = self._config, list[Pose]()
        found = list(found)
        for _ in range(config.turned):
            best = self._distinct(found)[:siblings]
            asked = next((pose for pose in best if not self._is_turned(pose, turned)), None)
            if asked is None:
                break
            asked = self._finished(asked)
            turned.append(asked)
            found += [asked, *self._turned(asked)]
        best = self._distinct(found)[: config.finished]
        finished = self._distinct([self._improved(pose, FINE_SCALES_M) for pose in best])
        if not finished:
            return finished
        least = finished[0].fit.log_likelihood - config.rival_log_likelihood
        rivals = [pose for pose in finished if pose.fit.log_likelihood >= least]
        if len(rivals) == 1 and self.seen.returns >= config.sharpened_returns:
            return finished
        return self._distinct([*map(self._sharpened, rivals), *finished[len(rivals) :]])

    def _finished(self, pose: Pose) -> Pose:
        """Return a pose finished, so that its turns are no worse than it is itself."""
        pose = self._improved(pose, FINE_SCALES_M)
        halfway = 0.0 < pose.fit.deficit < HALFWAY * self.seen.returns
        few = self.seen.returns < self._config.sharpened_returns  # which are sharpened in the end
        return self._sharpened(pose) if halfway and not few else pose

    def _is_turned(self, pose: Pose, turned: Sequence[Pose]) -> bool:
        """Return whether a pose has been turned, and not become much likelier since."""
        return any(
            alike and pose.fit.log_likelihood <= other.fit.log_likelihood + GAIN
            for alike, other in zip(self.alike([pose], turned)[0], turned, strict=True)
        )

    def alike(self, poses: Sequence[Pose], others: Sequence[Pose]) -> NDArray[np.bool_]:
        """Return which poses' attitudes are close to which others', or to their exact turns, shape (P, O)."""
        least = 1.0 + 2.0 * cos(radians(self._config.distinct_deg))
        exact = self._model.turns.exact
        R = np.array([pose.R for pose in poses]).reshape(-1, 1, 3, 3) @ exact
        other_R = np.array([other.R for other in others]).reshape(-1, 9)
        traces = (R.reshape(-1, 9) @ other_R.T).reshape(len(poses), len(exact), len(others))
        close: NDArray[np.bool_] = traces.max(axis=1, initial=-1.0) > least
        return close

    def settled(self, R: FloatArray, t: FloatArray, scales_m: FloatArray) -> Pose:
        """Return a nearly right pose after a step to the faces for each scale."""
        view, model = self._scanner.view, self._config.tracking.model
        problem = FaceProblem(
            self.seen.points_m,
            self.seen.rays,
            view.grid.arrays,
            self._model.surface.faces,
            self._model.surface.coarse_field,
            ScanErrors(self._scanner.statistics.sigma_range_m, model.slack_m, 0.0, 0.0),
            scales_m,
            view.hits.arrays,
        )
        (R, t), information, *_ = settle(problem, PoseArrays(R, t))
        return Pose(R, t, self._scanner.statistics.fit(self.seen, R, t), information)

    def _there(self, R: FloatArray, t: FloatArray) -> Pose:
        """Return a pose as it is; nothing is known of what determines it."""
        return Pose(R, t, self._scanner.statistics.fit(self.seen, R, t), np.zeros((6, 6)))

    def _improved(self, pose: Pose, scales_m: FloatArray) -> Pose:
        """Return a pose settled, but for where the faces lead astray what the outline has right."""
        settled = self.settled(pose.R, pose.t, scales_m)
        better = settled.fit.log_likelihood >= pose.fit.log_likelihood
        return settled if better else replace(pose, information=settled.information)

    def belief(self, pose: Pose) -> Belief:
        """Return whether a pose explains the scan."""
        return self._scanner.statistics.belief(self.seen, pose.R, pose.t, pose.fit)

    def _is_sure(self, pose: Pose) -> bool:
        returns = self.seen.returns
        return (
            returns >= self._config.sure_returns and pose.fit.deficit <= -self._config.sure_surplus * returns
        )

    def _candidates(
        self, attitudes: Float32Array, level: SearchLevelConfig
    ) -> Iterator[tuple[Float32Array, Float32Array]]:
        """Return rough poses R, t, least energy first."""
        if self.seen.cut_off:  # several places for each
            attitudes = attitudes[:: len(self._model.views.anchors_m) // 2]
        attitudes, places_m = self._laid(attitudes)
        energy = self._energies(attitudes, places_m, rounds=1, roughly=True)
        better = np.argsort(energy, kind="stable")[: level.compared]
        attitudes, places_m = attitudes[better], places_m[better]
        energy = self._energies(attitudes, places_m, rounds=2)
        for index in np.argsort(energy, kind="stable")[: level.refined]:
            if energy[index] < NOTHING_IN_VIEW:
                yield attitudes[index], places_m[index]

    def _laid(self, attitudes: Float32Array) -> tuple[Float32Array, Float32Array]:
        """Return attitudes and first guesses of the target's place, laid on the scan's centroid.

        A scan that the field of view cuts off shows any region of the target: each is tried.
        """
        views = self._model.views
        offsets_m: FloatArray | Float32Array
        if self.seen.cut_off:
            attitudes = np.repeat(attitudes, len(views.anchors_m), axis=0)
            offsets_m = np.tile(views.anchors_m, (len(attitudes) // len(views.anchors_m), 1))
        else:
            offsets_m = centroids_in_view(attitudes, self._centroid_m, views.centroids_m, views.cube)
        places_m = self._centroid_m - (attitudes @ offsets_m[..., None])[..., 0]
        return attitudes, places_m.astype(np.float32)

    def _energies(
        self, attitudes: Float32Array, places_m: Float32Array, *, rounds: int, roughly: bool = False
    ) -> Float32Array:
        """Return the energies of poses, whose places are laid on the scan anew."""
        views = self._model.views
        return energies(
            attitudes,
            places_m,
            seen=self.seen,
            points=views.few_points if roughly else views.points,
            squares=views.squares,
            image=self._image,
            detection=self._scanner.statistics.expected_shares,
            returns=FEW_RETURNS if roughly else MORE_RETURNS,
            rounds=rounds,
            truncation_m=self._config.truncation_m,
        )

    def _turned(self, pose: Pose) -> list[Pose]:
        """Return a pose's turns by near-symmetries, and the best of the others, where it is and laid anew."""
        turns = self._model.turns
        turned = (pose.R @ turns.all).astype(np.float32)
        here_m = np.tile(pose.t, (len(turned), 1)).astype(np.float32)
        here = self._energies(turned, here_m, rounds=0)
        here[: turns.declared] = 0.0
        anew, anew_m = self._laid(turned)
        laid = self._energies(anew, anew_m, rounds=2).reshape(len(turned), -1)
        best_m = anew_m.reshape(len(turned), -1, 3)[np.arange(len(turned)), laid.argmin(axis=1)]
        order = np.argsort(np.concatenate((here, laid.min(axis=1))), kind="stable")[: self._config.turns]
        return [
            self._improved(self._there(pose.R @ turns.all[index], pose.t), SETTLE_SCALES_M)
            if index < len(turned)
            else self._drawn_in(turned[index - len(turned)], best_m[index - len(turned)])
            for index in order
        ]

    def _drawn_in(self, R: Float32Array, t: Float32Array) -> Pose:
        """Return a rough pose drawn onto the scan."""
        pose = PoseArrays(R.astype(np.float64), t.astype(np.float64))
        aligned = field_aligned(self._few, pose, self._model.surface.coarse_field, self._far_m)
        return self.settled(*aligned, SETTLE_SCALES_M)

    def _sharpened(self, pose: Pose) -> Pose:
        """Return a pose moved to where the outline is explained best too; as it is without rays to ask."""
        if not self.seen.range_m.any():  # all returns lie beside the pattern
            return pose
        held: FloatArray = np.repeat((OPEN_M, OPEN_RAD), 3)
        covariance = np.linalg.inv(pose.information / STRETCH**2 + np.diag(held**-2)).astype(np.float64)
        R, t = self._scanner.statistics.sharpen(self.seen, pose.R, pose.t, covariance)
        return Pose(R, t, self._scanner.statistics.fit(self.seen, R, t), pose.information)

    def _distinct(self, poses: list[Pose]) -> list[Pose]:
        """Return the poses, likeliest first, without those close to a likelier one."""
        ranked = sorted(poses, key=lambda pose: -pose.fit.log_likelihood)
        alike = self.alike(ranked, ranked)
        kept: list[int] = []
        for index in range(len(ranked)):
            if not alike[index, kept].any():
                kept.append(index)
        return [ranked[index] for index in kept]
