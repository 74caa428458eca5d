"""The search in one PMD frame: from thousands of attitudes to a few poses, ranked by render and compare."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from rpod_pose.pmd.fit import PmdFit, PmdFitter
from rpod_pose.pmd.scene import PmdScene
from rpod_pose.pmd.simpler_surface import Surface
from rpod_pose.registration.distance_field import FieldArrays, field_arrays
from rpod_pose.registration.field_alignment import Points, field_aligned
from rpod_pose.registration.lie_group import PoseArrays
from rpod_pose.registration.surface_model import SurfaceModel
from rpod_pose.search.attitude_grid import within
from rpod_pose.search.comparison import Comparison
from rpod_pose.search.energy import NOTHING_IN_VIEW
from rpod_pose.search.even_samples import sobol
from rpod_pose.search.turns import Placed, Turns, matrices
from rpod_pose.search.view_model import ViewModel
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd.search import PmdAcquisitionTuning
from rpod_schemas.types import Float32Array
from rpod_target import Target

ANY_ECHO = 0.0, np.ones(1)
"""Steps and table (``energies``) of a sensor that detects every echo."""
FIELD_STEPS = np.geomspace(1.0, 0.2, 6)
"""Geman-McClure scales of the steps that align a candidate with the frame, over the truncation. Numerics: the
wide scales of the first steps converge from farther, the narrow ones of the last steps are more accurate."""
FINE_STEPS = np.geomspace(0.3, 0.1, 6)
"""Geman-McClure scales of the steps that refine the best candidates, over the truncation. Numerics: as
``FIELD_STEPS``, from poses that these have aligned."""
_ROUNDS, _SAMPLES = 6, 32
"""Number of rounds of the refinement on the outline, and of samples in each. Numerics: a budget of
computation."""
_FIRST_ROUNDS = 2
"""Number of rounds of the refinement on the outline after which poses are compared. Numerics: a budget of
computation."""
_POWER = 8
"""Logarithm to base 2 of the number of computed samples. Numerics: a Sobol sequence is even at powers of two;
at most 2^8 samples are used."""


@cache
def _draws() -> FloatArray:
    """Return evenly spread standard normal samples, deterministic, shape (_ROUNDS, _SAMPLES, 6)."""
    even = sobol(6, _POWER)[: _ROUNDS * _SAMPLES].clip(1e-3, 1.0 - 1e-3)
    samples: FloatArray = ndtri(even).reshape(_ROUNDS, _SAMPLES, 6)
    return samples


@dataclass(frozen=True, eq=False)
class Pose:
    """A pose of the target relative to the sensor, with its loss in the frame."""

    R: FloatArray
    """R_sensor_target, shape (3, 3)."""
    t: FloatArray
    """Position of the target's origin, sensor axes, shape (3,), m."""
    fit: PmdFit
    """Loss of the pose in the frame."""
    deviations: FloatArray | None = None
    """Standard deviations of the samples in the next round of the refinement on the outline, shape (6,)."""


@dataclass(frozen=True, eq=False)
class Model:
    """The target in the forms that the search needs."""

    target: Target
    views: ViewModel
    surface: SurfaceModel
    shown: Surface
    field: FieldArrays
    turns: Turns

    @classmethod
    def of(cls, target: Target, tuning: PmdAcquisitionTuning) -> Self:
        """Return the model of a target.

        Raises:
            rpod_target.TargetError: the target has no distance field.
        """
        surface = SurfaceModel.of(target)
        views = ViewModel.of(
            target,
            surface.coarse_field,
            count=tuning.model_points,
            truncation_m=tuning.truncation * target.radius_m,
        )
        return cls(target, views, surface, Surface.of(target), field_arrays(target), Turns.of(target))


class FrameSearch:
    """Searches one frame.

    Args:
        tuning: parameters of the search.
        model: the target.
        scene: the frame's coarse pixels.
        fitter: compares the coarse pixels with poses.
        possible: function that returns whether a pose near a given one may be that of the target; other poses
            are not refined completely.
    """

    def __init__(
        self,
        tuning: PmdAcquisitionTuning,
        model: Model,
        scene: PmdScene,
        fitter: PmdFitter,
        possible: Callable[[Pose], bool],
    ) -> None:
        self._tuning, self._model, self._scene, self._fitter = tuning, model, scene, fitter
        self._possible = possible
        radius_m, noise_m = model.target.radius_m, float(np.median(scene.sigma_m[scene.range_m > 0.0]))
        truncation_m, least_m = tuning.truncation * radius_m, tuning.scale_sigmas * noise_m
        self._field_scales_m = np.maximum(FIELD_STEPS * truncation_m, least_m)
        self._fine_scales_m = np.maximum(FINE_STEPS * truncation_m, least_m)
        self._draws = _draws()
        self._refined_sigmas = np.repeat((tuning.outline_sigma * radius_m, tuning.outline_sigma), 3)
        self._comparison = Comparison(
            model.views,
            scene.surface,
            scene.distances(),
            ANY_ECHO,
            truncation_m,
        )
        self._few = Points.equal(scene.downsampled(tuning.coarse_points))
        self._fine = Points.equal(scene.downsampled(tuning.fine_points))

    def search(
        self, attitudes: Float32Array, around: FloatArray | None, others: Iterable[Pose] = ()
    ) -> list[Pose]:
        """Return distinct poses, best first; empty if the target is in view at no attitude.

        Args:
            attitudes: initial R_sensor_target, shape (M, 3, 3).
            around: R_sensor_target, shape (3, 3), near which all poses must be; None for any attitude.
            others: poses that were found in another way and are compared, too.
        """
        tuning = self._tuning
        refined = tuning.refined if around is None else tuning.near_refined
        candidates = self._comparison.candidates(attitudes, compared=tuning.compared, refined=refined)
        found = [self._field_aligned(*candidate) for candidate in candidates]
        found += [self._fitted(pose.R, pose.t) for pose in others]
        turned: list[Pose] = []
        for _ in range(tuning.turned):
            best = self._distinct(found)
            close = self._model.turns.close(matrices(best), matrices(turned), tuning.distinct_deg)
            chosen = next((pose for pose, near in zip(best, close, strict=True) if not near.any()), None)
            if chosen is None:
                break
            chosen = self._refined(chosen)
            turned.append(chosen)
            found += [chosen, *self._turned(chosen, around)]
        return self._finished(self._distinct(found)[: tuning.finished])

    def _finished(self, poses: Iterable[Pose]) -> list[Pose]:
        """Return refined poses; those that may be the best are refined on the outline, too.

        After the first rounds of this refinement, losses are compared, and only poses that may still be the
        best are refined further. The comparison does not come earlier: little depth may leave the right pose
        some degrees off, and then its loss is much larger than that of a wrong pose that fits by chance.
        """
        refined = self._distinct(self._refined(pose) for pose in poses)
        if not refined:
            return []
        likely, least = self._tuning.rival_losses, refined[0].fit.loss
        begun = self._distinct(
            self._outline_refined(pose, self._draws[:_FIRST_ROUNDS])
            if pose.fit.loss <= likely * least and self._possible(pose)
            else pose
            for pose in refined
        )
        most = begun[0].fit.loss + self._tuning.rival_loss
        return self._distinct(
            self._outline_refined(pose, self._draws[_FIRST_ROUNDS:])
            if pose.fit.loss <= most and self._possible(pose)
            else pose
            for pose in begun
        )

    def _fitted(self, R: FloatArray, t: FloatArray) -> Pose:
        return Pose(R, t, self._fitter.fit(R, t))

    def _field_aligned(self, R: FloatArray, t: FloatArray) -> Pose:
        """Return a rough pose aligned with few of the points, or unchanged if that increases the loss."""
        field = self._model.surface.coarse_field
        aligned = field_aligned(self._few, PoseArrays(R, t), field, self._field_scales_m)
        return min(self._fitted(*aligned), self._fitted(R, t), key=lambda one: one.fit.loss)

    def turned(
        self,
        pose: Placed,
        left_out: Callable[[FloatArray], NDArray[np.bool_]],
        shape: PmdFitter,
        most: float,
    ) -> list[Pose]:
        """Return the likely turns of a pose: all declared ones unaligned, and the best others aligned.

        Args:
            pose: a pose of the target.
            left_out: returns which attitudes are left out, shape (N,), of R_sensor_target, shape (N, 3, 3).
            shape: compares the frame with poses by shape alone.
            most: largest loss of a likely pose by shape.
        """
        turns = self._model.turns
        declared: list[tuple[float, Pose]] = []
        others: list[tuple[float, Pose]] = []
        attitudes = pose.R @ turns.compared
        for number in np.flatnonzero(~left_out(attitudes)):
            R, is_declared = attitudes[number], number < turns.declared
            turned = self._fitted(R, pose.t) if is_declared else self._field_aligned(R, pose.t)
            if (loss := shape.fit(turned.R, turned.t).loss) <= most:
                (declared if is_declared else others).append((loss, turned))
        others.sort(key=lambda each: each[0])
        found = [turned for _, turned in (*declared, *others[: self._tuning.turns])]
        about = self._turned_about(pose, shape, most)
        known = turns.close(matrices(about), matrices(found), self._tuning.distinct_deg).any(axis=1)
        return found + [about[index] for index in np.flatnonzero(~(known | left_out(matrices(about))))]

    def _turned_about(self, pose: Placed, shape: PmdFitter, most: float) -> list[Pose]:
        """Return the likely turns of a pose about the axis of a nearly round target, aligned, the best first.

        Of all these turns, those are chosen that fit the frame better than their neighbours.
        """
        turns, centre_m = self._model.turns.about
        if not len(turns):
            return []
        attitudes = pose.R @ np.concatenate((np.eye(3)[None], turns))
        places_m = pose.t + (pose.R - attitudes) @ centre_m
        losses = np.array([shape.fit(*each).loss for each in zip(attitudes, places_m, strict=True)])
        beside = np.minimum(np.roll(losses, 1), np.roll(losses, -1))
        likely = np.flatnonzero((losses <= beside) & (losses <= most))
        best = likely[np.argsort(losses[likely], kind="stable")][: self._tuning.turns]
        return [self._field_aligned(attitudes[index], places_m[index]) for index in best if index]

    def _refined(self, pose: Pose) -> Pose:
        """Return a pose aligned with more of the points, or unchanged if that increases the loss."""
        start = PoseArrays(pose.R, pose.t)
        refined = self._fitted(*field_aligned(self._fine, start, self._model.field, self._fine_scales_m))
        return min(refined, pose, key=lambda one: one.fit.loss)

    def _outline_refined(self, pose: Pose, draws: FloatArray) -> Pose:
        """Return a pose refined on the outline and the amplitude, in as many rounds as there are samples."""
        deviations = self._refined_sigmas if pose.deviations is None else pose.deviations
        R, t, deviations = self._fitter.outline_refined(pose.R, pose.t, deviations, draws)
        return Pose(R, t, self._fitter.fit(R, t), deviations)

    def _turned(self, pose: Pose, around: FloatArray | None) -> list[Pose]:
        """Return a pose's near-symmetries at its position, and its best other turns at the centroid."""
        turns = self._model.turns
        exactly = pose.R @ turns.all
        turned = exactly.astype(np.float32)
        allowed = np.ones(len(turned), bool)
        if around is not None:
            allowed = within(turned, around, self._tuning.near_deg)
        if not allowed.any():
            return []
        _, anew_m = self._comparison.centroid_aligned(turned)
        energy = self._comparison.energies(turned, anew_m, rounds=2)
        declared = np.arange(len(turned)) < turns.declared
        energy[declared] = 0.0
        energy[~allowed] = NOTHING_IN_VIEW
        order = np.argsort(energy, kind="stable")[: self._tuning.turns]
        return [
            self._field_aligned(
                exactly[index], pose.t if declared[index] else anew_m[index].astype(np.float64)
            )
            for index in order
            if energy[index] < NOTHING_IN_VIEW
        ]

    def _distinct(self, poses: Iterable[Pose]) -> list[Pose]:
        """Return the poses, best first, without those close to a better one."""
        ranked = sorted(poses, key=lambda pose: pose.fit.loss)
        return self._model.turns.distinct(ranked, self._tuning.distinct_deg)
