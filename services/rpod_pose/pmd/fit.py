"""How badly a pose explains a PMD frame: the target is rendered and every coarse pixel is compared.

Where pose and frame agree on a surface, the loss is half the squared error in its standard deviations, of the
depth and of the amplitude, and saturates at what an outlier costs. Where one of them shows a surface and the
other does not, it is a constant: little where depth alone is lost, more where even the amplitude says
otherwise. What is asked are the pixels where pose or frame show the target, but for those that a glint wiped
out: there both may be right.

The amplitude is expected as of a Lambertian surface lit by a lamp at the camera: the albedo of its class
(``brightness``) times the cosine of incidence over the square of the range, up to one gain for the frame. The
class says how far its logarithm may be off, which is little less than everything for foil and metal.

Where the materials may be others than the target file's, no amplitude is compared, and only roughly is it
expected whether a surface is bright enough to be told from the sky: what is left is the shape.
"""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import kernel
from rpod_geometry.rays import GridArrays, cast_pose
from rpod_pose.pmd.scene import PmdScene
from rpod_pose.registration.brightness import albedos, spreads
from rpod_pose.registration.lie_group import turned
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd_search import PmdModelConfig
from rpod_schemas.types import Float32Array
from rpod_target import Target

STEEPEST = 0.1
"""Cosine of incidence below which the slack along the ray grows no more."""
GRAZING = 0.02
"""Cosine of incidence below which a surface is expected to be no darker."""
AGREES = 2.0
"""Loss below which a pixel agrees."""
DARK = -1.0
"""Logarithm of the amplitude below which, and where there is none, it is not compared."""
MARGIN = 6
"""Rows and columns beside what is lit that a pose may reach."""
GAIN_STRIDE = 3
"""Every how many pixels the gain is estimated on."""


class Surface(NamedTuple):
    """The target, as it is expected to look."""

    triangles_m: FloatArray
    """Shape (T, 3, 3)."""
    normals: FloatArray
    """Outward, shape (T, 3)."""
    albedo: FloatArray
    """Middle of each triangle's class, shape (T,)."""
    sigma_log: FloatArray
    """Standard deviation of the albedo's logarithm, shape (T,)."""


class Seen(NamedTuple):
    """A frame's coarse pixels, shape (rows, columns) each."""

    range_m: Float32Array
    """0 where there is none."""
    sigma_m: Float32Array
    """Standard deviation of the range's noise."""
    log_amplitude: Float32Array
    """Natural logarithm, counts."""
    lit: NDArray[np.bool_]
    """Where depth or amplitude show something."""
    blind: NDArray[np.bool_]
    """What glints hide."""


class Losses(NamedTuple):
    """What errors cost, and how large they are expected to be."""

    sigma_m: float
    """Standard deviation of a depth beside its noise."""
    slack_m: float
    """Standard deviation of the surface across its normal."""
    outlier: float
    """Most loss of a depth."""
    strange: float
    """Most loss of an amplitude, 0 where none is compared."""
    least_log_amplitude: float
    """From which on a pixel is lit."""
    lost: float
    """Of depth that is lost on a lit pixel."""
    dark: float
    """Of a dark pixel where the pose has surface."""
    beyond: float
    """Of a lit pixel where the pose has none."""


class Canvas(NamedTuple):
    """Buffers of a rendering, shape (rows, columns) each."""

    range_m: Float32Array
    """Predicted, along the ray."""
    triangle: NDArray[np.int32]
    """Which is seen, -1 for none."""
    loss: Float32Array
    """Of each pixel; before, the logarithm of its predicted amplitude."""
    sigma_log: Float32Array
    """Standard deviation of that logarithm."""


class Comparison(NamedTuple):
    """A frame, and all that it takes to compare it with poses."""

    surface: Surface
    grid: GridArrays
    """``RayGrid.arrays``."""
    seen: Seen
    losses: Losses
    canvas: Canvas


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
        block = _around(scene.lit | scene.blind)
        noise_m = np.minimum(scene.sigma_m, config.most_noise_m)
        amplitude = np.log(np.maximum(scene.amplitude, np.float32(0.1)))
        shape = noise_m[block].shape
        self._compared = Comparison(
            _surface(target, config, as_filed=as_filed),
            scene.view.coarse.block(*block),
            Seen(
                range_m=np.ascontiguousarray(scene.range_m[block]),
                sigma_m=np.ascontiguousarray(noise_m[block]),
                log_amplitude=np.ascontiguousarray(amplitude[block]),
                lit=np.ascontiguousarray(scene.lit[block]),
                blind=np.ascontiguousarray(scene.blind[block]),
            ),
            Losses(
                sigma_m=config.sigma_m,
                slack_m=config.slack_m,
                outlier=config.outlier_loss,
                strange=config.amplitude_outlier_loss if as_filed else 0.0,
                least_log_amplitude=float(np.log(scene.least_amplitude)) if scene.outlined else DARK,
                lost=config.lost_loss,
                dark=config.dark_loss if scene.outlined else config.lost_loss,
                beyond=config.beyond_loss,
            ),
            Canvas(
                np.empty(shape, np.float32),
                np.empty(shape, np.int32),
                np.zeros(shape, np.float32),
                np.zeros(shape, np.float32),
            ),
        )

    def fit(self, R: FloatArray, t: FloatArray) -> PmdFit:
        """Return how badly the pose R, t of the target in the sensor explains the frame."""
        return PmdFit(*compare(self._compared, R, t))

    def worst_patches(self, R: FloatArray, t: FloatArray, *sizes: int) -> list[float]:
        """Return for each size the mean loss a pixel of the size x size patch that a pose explains worst."""
        self.fit(R, t)
        loss = self._compared.canvas.loss
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
        sharper: tuple[FloatArray, FloatArray] = _sharpen(self._compared, R, t, deviations, draws)
        return sharper


def _surface(target: Target, config: PmdModelConfig, *, as_filed: bool) -> Surface:
    """Return the target as it should look; what may be of any material is known a little less still."""
    sigma_log = spreads(target)
    if not as_filed:
        sigma_log = np.maximum(sigma_log, config.strange_log_amplitude)
    return Surface(
        np.ascontiguousarray(target.triangles_m),
        np.ascontiguousarray(target.normals),
        albedos(target),
        sigma_log,
    )


def _around(pixels: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Return the rows and columns that hold some pixels, and a margin."""
    row, column = (np.flatnonzero(pixels.any(axis=axis)) for axis in (1, 0))
    return _widened(row), _widened(column)


def _widened(lines: NDArray[np.intp]) -> slice:
    return slice(max(0, lines[0] - MARGIN), lines[-1] + 1 + MARGIN)


@kernel
def compare(compared: Comparison, R: FloatArray, t: FloatArray) -> tuple[float, int, int]:
    """Return the summed loss, and the numbers of pixels asked and agreeing; fill their losses.

    Args:
        compared: ``Comparison``.
        R: of the target in the sensor, shape (3, 3).
        t: of the target in the sensor, shape (3,), m.
    """
    surface, grid, seen, losses, canvas = compared
    range_m, owner, loss, sigma_log = canvas
    cast_pose(grid, surface.triangles_m, R, t, True, range_m, owner)
    rays = grid[0]
    gain = _predict(compared, R)
    total, pixels, agreeing = 0.0, 0, 0
    for i in range(range_m.shape[0]):
        for j in range(range_m.shape[1]):
            k = owner[i, j]
            if seen.blind[i, j]:
                loss[i, j] = 0.0
                continue
            if k < 0:
                loss[i, j] = losses.beyond if seen.lit[i, j] else 0.0
                if seen.lit[i, j]:
                    pixels += 1
                    total += losses.beyond
                continue
            pixels += 1
            above = max(loss[i, j] + gain - losses.least_log_amplitude, 0.0) / sigma_log[i, j]
            worse = min(losses.lost + 0.5 * above * above, losses.dark)
            if seen.range_m[i, j] > 0.0:
                facing = _facing(surface.normals[k], R, rays[0, i, j], rays[1, i, j], rays[2, i, j])
                steep_m = losses.slack_m / max(facing, STEEPEST)
                variance_m2 = losses.sigma_m**2 + steep_m * steep_m + seen.sigma_m[i, j] ** 2
                worse = _saturated((seen.range_m[i, j] - range_m[i, j]) ** 2 / variance_m2, losses.outlier)
            elif seen.lit[i, j]:
                worse = losses.lost
            if losses.strange > 0.0 and seen.lit[i, j] and seen.log_amplitude[i, j] > DARK:
                e = (seen.log_amplitude[i, j] - loss[i, j] - gain) / sigma_log[i, j]
                worse += _saturated(e * e, losses.strange)
            loss[i, j] = worse
            total += worse
            if worse < AGREES:
                agreeing += 1
    return total, pixels, agreeing


@kernel
def _saturated(square: float, most: float) -> float:
    """Return half of a squared error in standard deviations, which grows to ``most`` (Geman-McClure)."""
    return most * square / (2.0 * most + square)


@kernel
def _facing(normal: FloatArray, R: FloatArray, x: float, y: float, z: float) -> float:
    """Return the cosine of incidence of the ray (x, y, z) on a face whose normal is in target axes."""
    a = R[0, 0] * normal[0] + R[0, 1] * normal[1] + R[0, 2] * normal[2]
    b = R[1, 0] * normal[0] + R[1, 1] * normal[1] + R[1, 2] * normal[2]
    c = R[2, 0] * normal[0] + R[2, 1] * normal[1] + R[2, 2] * normal[2]
    cosine: float = abs(a * x + b * y + c * z)
    return cosine


@kernel
def _predict(compared: Comparison, R: FloatArray) -> float:
    """Fill in logarithms of predicted amplitudes up to a gain, and their sigmas; return the gain's logarithm.

    The expectation is Lambert's: albedo cos(theta) / range^2. The gain is a median, weighted by what is known
    of each pixel's albedo.
    """
    surface, grid, seen, _, canvas = compared
    range_m, owner, predicted, sigma_log = canvas
    rays = grid[0]
    ratios, weights = np.empty(owner.size // GAIN_STRIDE + 1), np.empty(owner.size // GAIN_STRIDE + 1)
    count, asked = 0, 0
    for i in range(owner.shape[0]):
        for j in range(owner.shape[1]):
            k = owner[i, j]
            predicted[i, j] = 0.0
            if k < 0:
                continue
            facing = _facing(surface.normals[k], R, rays[0, i, j], rays[1, i, j], rays[2, i, j])
            lambert = surface.albedo[k] * max(facing, GRAZING)
            predicted[i, j] = np.log(lambert / (range_m[i, j] * range_m[i, j]))
            sigma_log[i, j] = surface.sigma_log[k]
            if seen.lit[i, j] and seen.log_amplitude[i, j] > DARK:
                if asked % GAIN_STRIDE == 0:
                    ratios[count] = seen.log_amplitude[i, j] - predicted[i, j]
                    weights[count] = 1.0 / sigma_log[i, j] ** 2
                    count += 1
                asked += 1
    return _weighted_median(ratios[:count], weights[:count]) if count else 0.0


@kernel
def _weighted_median(values: FloatArray, weights: FloatArray) -> float:
    """Return the value, shape (N,), below which half of the weights, shape (N,), lie."""
    half, below = 0.5 * weights.sum(), 0.0
    order = np.argsort(values)
    median = float(values[order[-1]])
    for n in order:
        below += weights[n]
        if below >= half:
            median = float(values[n])
            break
    return median


@kernel
def _sharpen(
    compared: Comparison, R: FloatArray, t: FloatArray, deviations: FloatArray, draws: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the pose R, t of least loss of all that the samples tried (``PmdFitter.sharpened``)."""
    rounds, samples = draws.shape[0], draws.shape[1]
    best_R, best_t = R, t
    least = compare(compared, R, t)[0]
    mean, spread = np.zeros(6), deviations.copy()
    elite = max(4, samples // 5)
    for turn in range(rounds):
        steps, costs = np.empty((samples, 6)), np.empty(samples)
        for n in range(samples):
            steps[n] = mean + spread * draws[turn, n]
            moved_R, moved_t = turned(R, steps[n, 3:]), t + R @ steps[n, :3]
            costs[n] = compare(compared, moved_R, moved_t)[0]
            if costs[n] < least:
                least, best_R, best_t = costs[n], moved_R, moved_t
        order = np.argsort(costs)[:elite]
        for axis in range(6):
            chosen = steps[order, axis]
            mean[axis] = chosen.mean()
            spread[axis] = chosen.std()
    return best_R, best_t
