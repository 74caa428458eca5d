"""Loss of a pose in a PMD frame: the target is rendered, and every coarse pixel is compared.

On a pixel where both pose and frame show a surface, the loss is half the squared error in standard
deviations, of the depth and of the amplitude, and saturates at the loss of an outlier. On a pixel where only
one of them shows a surface, the loss is a constant: small if only the depth is missing, larger if the
amplitude is inconsistent too. All pixels on which pose or frame show the target are compared, except those
that a glint saturated: they contain nothing about the pose.

The expected amplitude is that of a Lambertian surface lit from the camera: the albedo of its class
(``brightness``) times the cosine of incidence over the square of the range, up to one gain for the frame. The
class also gives the standard deviation of the albedo's logarithm, which is large for foil and metal.

If the materials may differ from those of the target file, no amplitude is compared, and it is only roughly
predicted whether a surface is brighter than the sky. Then only the shape is compared.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import inner_kernel, kernel
from rpod_geometry.rays import GridArrays, cast_pose
from rpod_geometry.windows import window_around
from rpod_pose.cancellation import stop_if_cancelled
from rpod_pose.pmd.rendering import RenderingArrays, around
from rpod_pose.pmd.scene import PmdScene
from rpod_pose.pmd.simpler_surface import Surface
from rpod_pose.registration.lie_group import PoseArrays, turned
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd.search import PmdModelConfig
from rpod_schemas.types import Float32Array

STEEPEST = 0.1
"""Least cosine of incidence by which the slack along the normal is converted to the ray. Numerics: it avoids
a division by zero; the angle is 84 deg."""
GRAZING = 0.02
"""Least cosine of incidence in the expected amplitude. Numerics: it avoids the logarithm of zero."""
DARK = -1.0
"""Logarithm of the least amplitude that is compared. Numerics: it is less than one count."""
BLURRED_PX = 1.5
"""Distance from the outline within which a pixel may be lit, px. Physics: half the width of a pixel, and one
pixel by the 3 x 3 median."""
MARGIN = 6
"""Number of rows and columns around the lit pixels that are compared. Numerics: a budget; a pose that reaches
farther is compared on fewer pixels."""
GAIN_STRIDE = 3
"""Stride of the pixels from which the gain is estimated. Numerics: a budget of computation."""


class Seen(NamedTuple):
    """A frame's coarse pixels; each array has the shape (rows, columns)."""

    range_m: Float32Array
    """Range along the ray; 0 if a pixel has none."""
    sigma_m: Float32Array
    """Standard deviation of the range's noise."""
    log_amplitude: Float32Array
    """Natural logarithm of the amplitude in counts."""
    lit: NDArray[np.bool_]
    """Pixels on which depth or amplitude show a surface."""
    blind: NDArray[np.bool_]
    """Pixels that glints saturated."""
    stride: int
    """Distance from one coarse pixel to the next, px, at least 1."""


class Losses(NamedTuple):
    """Losses of errors, and the expected sizes of errors."""

    sigma_m: float
    """Standard deviation of a depth in addition to its noise."""
    slack_m: float
    """Standard deviation of the surface's position along its normal."""
    outlier: float
    """Largest loss of a depth."""
    amplitude_outlier: float
    """Largest loss of an amplitude; 0 if no amplitude is compared."""
    least_log_amplitude: float
    """Logarithm of the least amplitude of a lit pixel."""
    lost: float
    """Loss of a lit pixel without depth where the rendering has a surface."""
    dark: float
    """Loss of a dark pixel where the rendering has a surface."""
    beyond: float
    """Loss of a lit pixel where the rendering has no surface."""


class Canvas(NamedTuple):
    """Buffers of a rendering; each has the shape (rows, columns)."""

    range_m: Float32Array
    """Predicted range along the ray."""
    triangle: NDArray[np.int32]
    """Index of the visible triangle, -1 for none."""
    loss: Float32Array
    """Loss of each pixel; before it is computed, the logarithm of the predicted amplitude."""
    sigma_log: Float32Array
    """Standard deviation of the logarithm of the predicted amplitude."""


class Comparison(NamedTuple):
    """A frame with all data that are needed to compare it with poses."""

    surface: Surface
    grid: GridArrays
    """``RayGrid.arrays``."""
    seen: Seen
    losses: Losses
    canvas: Canvas


@dataclass(frozen=True, eq=False)
class PmdFit:
    """Result of the comparison of a pose with a frame."""

    loss: float
    """Sum of the losses over the pixels on which pose or frame show the target."""
    pixels: int
    """Number of these pixels."""

    @property
    def mean_loss(self) -> float:
        """Mean loss per pixel; infinite if there is none."""
        return self.loss / self.pixels if self.pixels else float("inf")


class PmdFitter:
    """Compares one frame with a target at any pose.

    Args:
        config: assumptions about the frame.
        surface: the target to render.
        scene: the frame's coarse pixels.
        known_materials: whether the materials are those of the target file; if not, only the shape counts.
    """

    def __init__(
        self, config: PmdModelConfig, surface: Surface, scene: PmdScene, *, known_materials: bool = True
    ) -> None:
        if not known_materials:
            certain_at_most = np.maximum(surface.sigma_log, config.strange_log_amplitude)
            surface = surface._replace(sigma_log=certain_at_most)
        block = window_around(scene.lit | scene.blind, (MARGIN, MARGIN))
        noise_m = np.minimum(scene.sigma_m, config.most_noise_m)
        amplitude = np.log(np.maximum(scene.amplitude, np.float32(0.1)))
        shape = noise_m[block].shape
        self._compared = Comparison(
            surface,
            scene.view.coarse.block(*block),
            Seen(
                range_m=np.ascontiguousarray(scene.range_m[block]),
                sigma_m=np.ascontiguousarray(noise_m[block]),
                log_amplitude=np.ascontiguousarray(amplitude[block]),
                lit=np.ascontiguousarray(scene.lit[block]),
                blind=np.ascontiguousarray(scene.blind[block]),
                stride=scene.view.stride,
            ),
            Losses(
                sigma_m=config.sigma_m,
                slack_m=config.slack_share * surface.radius_m,
                outlier=config.outlier_loss,
                amplitude_outlier=config.amplitude_outlier_loss if known_materials else 0.0,
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

    def fit(self, R: FloatArray, t: FloatArray, *, bias_m: float = 0.0) -> PmdFit:
        """Return the loss of a pose, with all ranges shortened by a bias.

        Args:
            R: R_sensor_target, shape (3, 3).
            t: position of the target, sensor axes, shape (3,), m.
            bias_m: length by which all ranges are too long.
        """
        stop_if_cancelled()
        compared, seen = self._compared, self._compared.seen
        if bias_m:
            range_m = np.where(seen.range_m > 0.0, seen.range_m - np.float32(bias_m), np.float32(0.0))
            compared = compared._replace(seen=seen._replace(range_m=range_m))
        return PmdFit(*compare(compared, R, t))

    def outline_refined(
        self, R: FloatArray, t: FloatArray, deviations: FloatArray, draws: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the pose R, t of least loss near a given one, and the deviations of the next samples.

        The loss has no gradient at outlines. So poses are sampled from a normal distribution that follows the
        best samples (the cross-entropy method, R. Y. Rubinstein, 1999).

        Args:
            R: R_sensor_target, shape (3, 3).
            t: position of the target, sensor axes, shape (3,), m.
            deviations: sigmas of (dtau, dtheta) as in ``normal_equations``, m and rad, shape (6,).
            draws: standard normal samples, shape (rounds, samples, 6).
        """
        best_R, best_t, spread = _outline_refined(self._compared, R, t, deviations, draws)
        return best_R, best_t, spread


@kernel
def compare(compared: Comparison, R: FloatArray, t: FloatArray) -> tuple[float, int]:
    """Return the summed loss and the number of compared pixels; fill the pixels' losses.

    Args:
        compared: frame, target and buffers.
        R: R_sensor_target, shape (3, 3).
        t: position of the target in the sensor, shape (3,), m.
    """
    surface, grid, seen, losses, canvas = compared
    range_m, owner, loss, sigma_log = canvas
    cast_pose(grid, surface.triangles_m, R, t, True, range_m, owner)
    rays = grid[0]
    rendered = RenderingArrays(range_m, owner, rays, seen.stride, surface.triangles_m, PoseArrays(R, t))
    gain = _predict(compared, R)
    total, pixels = 0.0, 0
    for i in range(range_m.shape[0]):
        for j in range(range_m.shape[1]):
            k = owner[i, j]
            if seen.blind[i, j]:
                loss[i, j] = 0.0
                continue
            if k < 0:
                loss[i, j] = 0.0
                if seen.lit[i, j] and around(rendered, i, j, BLURRED_PX).hits == 0:
                    loss[i, j] = losses.beyond
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
            if losses.amplitude_outlier > 0.0 and seen.lit[i, j] and seen.log_amplitude[i, j] > DARK:
                e = (seen.log_amplitude[i, j] - loss[i, j] - gain) / sigma_log[i, j]
                worse += _saturated(e * e, losses.amplitude_outlier)
            loss[i, j] = worse
            total += worse
    return total, pixels


@inner_kernel
def _saturated(square: float, most: float) -> float:
    """Return half of a squared error in standard deviations, saturated at ``most`` (Geman-McClure)."""
    return most * square / (2.0 * most + square)


@inner_kernel
def _facing(normal: FloatArray, R: FloatArray, x: float, y: float, z: float) -> float:
    """Return the cosine of incidence of the ray (x, y, z) on a face.

    ``normal`` is in target axes, shape (3,). ``R`` turns target axes to sensor axes, shape (3, 3).
    """
    a = R[0, 0] * normal[0] + R[0, 1] * normal[1] + R[0, 2] * normal[2]
    b = R[1, 0] * normal[0] + R[1, 1] * normal[1] + R[1, 2] * normal[2]
    c = R[2, 0] * normal[0] + R[2, 1] * normal[1] + R[2, 2] * normal[2]
    cosine: float = abs(a * x + b * y + c * z)
    return cosine


@inner_kernel
def _predict(compared: Comparison, R: FloatArray) -> float:
    """Fill the log amplitudes predicted up to a gain, and their sigmas; return the logarithm of the gain.

    The prediction follows Lambert's law: albedo cos(theta) / range^2. The gain is a median, weighted by the
    inverse variance of each pixel's log albedo. ``R`` turns target axes to sensor axes, shape (3, 3).
    """
    surface, grid, seen, _, canvas = compared
    range_m, owner, predicted, sigma_log = canvas
    rays = grid[0]
    ratios, weights = np.empty(owner.size // GAIN_STRIDE + 1), np.empty(owner.size // GAIN_STRIDE + 1)
    count, sampled = 0, 0
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
                if sampled % GAIN_STRIDE == 0:
                    ratios[count] = seen.log_amplitude[i, j] - predicted[i, j]
                    weights[count] = 1.0 / sigma_log[i, j] ** 2
                    count += 1
                sampled += 1
    return _weighted_median(ratios[:count], weights[:count]) if count else 0.0


@inner_kernel
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
def _outline_refined(
    compared: Comparison, R: FloatArray, t: FloatArray, deviations: FloatArray, draws: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the pose R, t of least loss among all samples (``PmdFitter.outline_refined``)."""
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
    return best_R, best_t, spread
