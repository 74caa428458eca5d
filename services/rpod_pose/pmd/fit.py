"""How badly a pose explains a PMD frame: the target is rendered and every coarse pixel is compared.

Where pose and frame agree on a surface, the loss is half the squared error in its standard deviations, of the
depth and of the amplitude, and saturates at what an outlier costs. Where one of them shows a surface and the
other does not, it is a constant: little where depth alone is lost, more where even the amplitude says
otherwise. The amplitude is predicted by the camera's own model of reflection up to one gain for the frame.
What is asked are the pixels where pose or frame show the target, but for those that a glint wiped out: there
both may be right.

Where the materials may be others than the target file's, no amplitude is compared, and only roughly is it
expected whether a surface is bright enough to be told from the sky: what is left is the shape.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from rpod_geometry.rays import cast_pose
from rpod_pose.pmd.scene import PmdScene
from rpod_pose.registration.lie_group import turned
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd_search import PmdModelConfig
from rpod_sim_sensor.pmd.reflection import reflected_share
from rpod_target import Material, Target

STEEPEST = 0.1
"""Cosine of incidence below which the slack along the ray grows no more."""
AGREES = 2.0
"""Loss below which a pixel agrees."""
DARK = -1.0
"""Logarithm of the amplitude below which, and where there is none, it is not compared."""
MARGIN = 6
"""Rows and columns beside what is lit that a pose may reach."""
GAIN_STRIDE = 3
"""Every how many pixels the gain is estimated on."""


@dataclass(frozen=True, eq=False)
class PmdFit:
    """How badly a pose explains a frame."""

    loss: float
    """Summed over the pixels where pose or frame show the target."""
    pixels: int
    """Their number."""
    agreeing: int
    """Those of them on which pose and frame agree."""

    @property
    def explained_share(self) -> float:
        """Share of the pixels that agrees; NaN where there is none."""
        return self.agreeing / self.pixels if self.pixels else float("nan")

    @property
    def mean_loss(self) -> float:
        """A pixel."""
        return self.loss / self.pixels if self.pixels else float("inf")


class PmdFitter:
    """Compares one frame with a target at any pose.

    Args:
        config: what is expected of the frame.
        target: what is rendered.
        scene: the frame.
        as_filed: whether the materials are those of the target's file; else the shape alone is compared.
    """

    def __init__(
        self, config: PmdModelConfig, target: Target, scene: PmdScene, *, as_filed: bool = True
    ) -> None:
        materials = np.array([(m.diffuse, m.f0, _lobe(m)) for m in target.materials])
        optics = materials[target.triangle_material]
        self._surface = np.ascontiguousarray(target.triangles_m), np.ascontiguousarray(target.normals), optics
        block = _around(scene.lit | scene.blind)
        noise_m = np.minimum(scene.sigma_m, config.most_noise_m)
        amplitude = np.log(np.maximum(scene.amplitude, np.float32(0.1)))
        images = scene.range_m, noise_m, amplitude, scene.lit, scene.blind
        self._seen = tuple(np.ascontiguousarray(image[block]) for image in images)
        self._grid = scene.view.coarse.block(*block)
        self._noise = (
            config.sigma_m,
            config.slack_m,
            config.outlier_loss,
            config.amplitude_outlier_loss if as_filed else 0.0,
            config.sigma_log_amplitude if as_filed else config.strange_log_amplitude,
            config.mirror_log_amplitude,
            config.foil_share,
            float(np.log(scene.least_amplitude)) if scene.outlined else DARK,
        )
        dark_loss = config.dark_loss if scene.outlined else config.lost_loss
        self._losses = config.lost_loss, dark_loss, config.beyond_loss
        shape = noise_m[block].shape
        self._buffers = (
            np.empty(shape, np.float32),
            np.empty(shape, np.int32),
            np.zeros(shape, np.float32),
            np.zeros(shape, np.float32),
        )

    def fit(self, R: FloatArray, t: FloatArray) -> PmdFit:
        """Return how badly the pose R, t of the target in the sensor explains the frame."""
        return PmdFit(
            *compare(self._surface, R, t, self._grid, self._seen, self._noise, self._losses, self._buffers)
        )

    def worst_patches(self, R: FloatArray, t: FloatArray, *sizes: int) -> list[float]:
        """Return for each size the mean loss a pixel of the size x size patch that a pose explains worst."""
        self.fit(R, t)
        loss = self._buffers[2]
        return [float(cv2.blur(loss, (px, px), borderType=cv2.BORDER_CONSTANT).max()) for px in sizes]

    def sharpened(
        self, R: FloatArray, t: FloatArray, deviations: FloatArray, draws: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the pose of least loss near one.

        The loss has no gradient at outlines, so samples of a normal distribution follow the best of them (the
        cross-entropy method, R. Y. Rubinstein, 1999).

        Args:
            R: of the target in the sensor, shape (3, 3).
            t: of the target in the sensor, shape (3,), m.
            deviations: sigmas of (dtau, dtheta) of ``normal_equations``, m and rad, shape (6,).
            draws: standard normal samples, shape (rounds, samples, 6).
        """
        sharper: tuple[FloatArray, FloatArray] = _sharpen(
            self._surface,
            R,
            t,
            self._grid,
            self._seen,
            self._noise,
            self._losses,
            self._buffers,
            deviations,
            draws,
        )
        return sharper


def _lobe(material: Material) -> float:
    """Return the squared width of a material's lobe, its crinkles included."""
    return float(material.roughness**4 + 2.0 * np.tan(np.deg2rad(material.crinkle_deg)) ** 2)


def _around(pixels: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Return the rows and columns that hold some pixels, and a margin."""
    row, column = (np.flatnonzero(pixels.any(axis=axis)) for axis in (1, 0))
    return _widened(row), _widened(column)


def _widened(lines: NDArray[np.intp]) -> slice:
    return slice(max(0, lines[0] - MARGIN), lines[-1] + 1 + MARGIN)


@njit(cache=True, nogil=True, error_model="numpy")
def compare(surface, R, t, grid, seen, noise, losses, buffers):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    """Return the summed loss, and the numbers of pixels asked and agreeing; fill their losses.

    Args:
        surface: triangles (T, 3, 3), normals (T, 3), and of each triangle diffuse albedo, specular
            reflectance and squared width of the lobe (T, 3).
        R: of the target in the sensor, shape (3, 3).
        t: of the target in the sensor, shape (3,), m.
        grid: ``RayGrid.arrays``.
        seen: ranges, their noise, logarithms of amplitudes, what is lit, and what glints hide, shape
            (rows, columns) each.
        noise: sigma and slack of a depth, m; losses of outliers of depth and amplitude, 0 where no amplitude
            is compared; sigma of the amplitude's logarithm, what a lobe adds, and the least share of a
            mirror's lobe; logarithm of the least amplitude that is lit.
        losses: of depth lost on a lit pixel, of a dark one, of one beyond the outline.
        buffers: ranges, triangles, losses, and sigmas of amplitudes, shape (rows, columns) each.
    """
    triangles, normals, _ = surface
    range_m, owner, loss, vague = buffers
    cast_pose(grid, triangles, R, t, True, range_m, owner)
    rays = grid[0]
    rows, columns = range_m.shape
    sigma, slack, outliers, strange, _, _, _, least = noise
    lost, dark, beyond = losses
    gain = _predict(surface, R, grid, seen, noise, buffers)
    measured, spread, amplitude, lit, blind = seen
    total, pixels, agreeing = 0.0, 0, 0
    for i in range(rows):
        for j in range(columns):
            k = owner[i, j]
            if blind[i, j]:
                loss[i, j] = 0.0
                continue
            if k < 0:
                loss[i, j] = beyond if lit[i, j] else 0.0
                if lit[i, j]:
                    pixels += 1
                    total += beyond
                continue
            pixels += 1
            above = max(loss[i, j] + gain - least, 0.0) / vague[i, j]
            worse = min(lost + 0.5 * above * above, dark)
            if measured[i, j] > 0.0:
                facing = _facing(normals[k], R, rays[0, i, j], rays[1, i, j], rays[2, i, j])
                steep = slack / max(facing, STEEPEST)
                variance = sigma * sigma + steep * steep + spread[i, j] ** 2
                e2 = (measured[i, j] - range_m[i, j]) ** 2 / variance
                worse = outliers * e2 / (2.0 * outliers + e2)
            elif lit[i, j]:
                worse = lost
            if strange > 0.0 and lit[i, j] and amplitude[i, j] > DARK:
                e = amplitude[i, j] - loss[i, j] - gain
                e2 = e * e / vague[i, j] ** 2
                worse += strange * e2 / (2.0 * strange + e2)
            loss[i, j] = worse
            total += worse
            if worse < AGREES:
                agreeing += 1
    return total, pixels, agreeing


@njit(cache=True, nogil=True)
def _facing(normal, R, x, y, z):  # type: ignore[no-untyped-def]
    """Return the cosine of incidence of the ray (x, y, z) on a face whose normal is in target axes."""
    a = R[0, 0] * normal[0] + R[0, 1] * normal[1] + R[0, 2] * normal[2]
    b = R[1, 0] * normal[0] + R[1, 1] * normal[1] + R[1, 2] * normal[2]
    c = R[2, 0] * normal[0] + R[2, 1] * normal[1] + R[2, 2] * normal[2]
    return abs(a * x + b * y + c * z)


@njit(cache=True, nogil=True, error_model="numpy")
def _predict(surface, R, grid, seen, noise, buffers):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    """Fill in logarithms of predicted amplitudes up to a gain, and their sigmas; return the gain's logarithm.

    The more of an amplitude is reflected by the lobe, the less is known of it.
    """
    _, normals, optics = surface
    range_m, owner, predicted, vague = buffers
    rays, (_, _, amplitude, lit, _) = grid[0], seen
    rows, columns = owner.shape
    ratios, weights = np.empty(owner.size // GAIN_STRIDE + 1), np.empty(owner.size // GAIN_STRIDE + 1)
    count = 0
    asked = 0
    for i in range(rows):
        for j in range(columns):
            k = owner[i, j]
            predicted[i, j] = 0.0
            if k < 0:
                continue
            facing = _facing(normals[k], R, rays[0, i, j], rays[1, i, j], rays[2, i, j])
            facing = max(facing, 0.02)
            share = reflected_share(facing, facing, 1.0, optics[k, 0], optics[k, 1], optics[k, 2])
            mirrored = 1.0 - facing * optics[k, 0] / (np.pi * share)
            predicted[i, j] = np.log(share / (range_m[i, j] * range_m[i, j]))
            vague[i, j] = noise[4] + noise[5] * max(mirrored, noise[6] * optics[k, 1])
            if lit[i, j] and amplitude[i, j] > DARK:
                if asked % GAIN_STRIDE == 0:
                    ratios[count] = amplitude[i, j] - predicted[i, j]
                    weights[count] = 1.0 / vague[i, j] ** 2
                    count += 1
                asked += 1
    return _weighted_median(ratios[:count], weights[:count]) if count else 0.0


@njit(cache=True, nogil=True)
def _weighted_median(values, weights):  # type: ignore[no-untyped-def]
    half, below = 0.5 * weights.sum(), 0.0
    order = np.argsort(values)
    for n in order:
        below += weights[n]
        if below >= half:
            return values[n]
    return values[order[-1]]


@njit(cache=True, nogil=True, error_model="numpy")
def _sharpen(surface, R, t, grid, seen, noise, losses, buffers, deviations, draws):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    rounds, samples = draws.shape[0], draws.shape[1]
    best_R, best_t = R, t
    least = compare(surface, R, t, grid, seen, noise, losses, buffers)[0]
    mean, spread = np.zeros(6), deviations.copy()
    elite = max(4, samples // 5)
    for turn in range(rounds):
        steps, costs = np.empty((samples, 6)), np.empty(samples)
        for n in range(samples):
            steps[n] = mean + spread * draws[turn, n]
            moved_R, moved_t = turned(R, steps[n, 3:]), t + R @ steps[n, :3]
            costs[n] = compare(surface, moved_R, moved_t, grid, seen, noise, losses, buffers)[0]
            if costs[n] < least:
                least, best_R, best_t = costs[n], moved_R, moved_t
        order = np.argsort(costs)[:elite]
        for axis in range(6):
            chosen = steps[order, axis]
            mean[axis] = chosen.mean()
            spread[axis] = chosen.std()
    return best_R, best_t
