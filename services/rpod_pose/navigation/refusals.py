"""Reasons, for the operator, why the filter's gate refused a pose."""

from math import degrees, inf, isfinite

import numpy as np

from rpod_pose.navigation.dynamics.manoeuvre import needed
from rpod_pose.navigation.dynamics.slewing import relied_on
from rpod_pose.navigation.filter import ATTITUDE, POSITION, FilterState, Innovation, Manoeuvre, gate_nis
from rpod_pose.navigation.history import History
from rpod_pose.navigation.pose_measurement import PoseMeasurement, compared
from rpod_schemas.config.estimator import EstimatorSettings
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.messages import NANOSECONDS

BESIDE = (
    "; mount, clock or ranges of this sensor or of those that track are wrong: compare them with "
    "rpod driver check --against"
)
"""Causes of a difference between two sensors, with the remedy."""


class Refusals:
    """Composes the reasons for refused poses; its only state is its configuration.

    Args:
        settings: settings of the estimator.
    """

    def __init__(self, settings: EstimatorSettings) -> None:
        self._config = settings.filter

    def explain(
        self,
        history: History,
        predicted: FilterState,
        measured: PoseMeasurement,
        *,
        nis: float,
        tracked: bool,
    ) -> str:
        """Return the reason of a refusal: the gate, the figures, and the setting to change.

        Args:
            history: the history before the pose.
            predicted: the prediction to its stamp.
            measured: the pose.
            nis: its normalised innovation squared.
            tracked: whether the track's twist is estimated already; otherwise it is the initial one.
        """
        before, text = (
            history.before(measured.stamp_ns, self._config),
            refused(history, predicted, measured, nis, self._config),
        )
        if before is None or not isfinite(nis):
            return text
        if measured.stamp_ns <= before.stamp_ns:  # another sensor's pose at the same time
            return text + relied_on(before)
        least = needed(before, predicted, measured, self._config)
        settings = self._densities(least) if tracked else _priors(least)
        if settings:
            text += f"; if the target really moves so, raise {' and '.join(settings)}"
        return text + relied_on(before)

    def _densities(self, least: Manoeuvre) -> list[str]:
        config = self._config
        raised = {
            "filter.acceleration_density_m2_s3": config.acceleration_density_m2_s3 * least.acceleration,
            "filter.angular_acceleration_density_rad2_s3": config.angular_acceleration_density_rad2_s3
            * least.angular,
        }
        return [
            f"{name} to {value:.1g}"
            for (name, value), factor in zip(raised.items(), least, strict=True)
            if 1.0 < factor < inf
        ]


def refused(
    history: History, predicted: FilterState, measured: PoseMeasurement, nis: float, config: FilterConfig
) -> str:
    """Return that the gate refused a pose, with the figures; arguments as for ``Refusals.explain``."""
    before, text = history.before(measured.stamp_ns, config), f"gate: nis {nis:.1f}"
    if before is None or not isfinite(nis):
        return text
    found = compared(predicted, measured, config)
    return f"{text}, limit {gate_nis(predicted, config):.1f}: {_beyond(before, predicted, found)}"


def refused_newcomer(
    history: History, predicted: FilterState, measured: PoseMeasurement, nis: float, config: FilterConfig
) -> str:
    """Return why the pose of a sensor that does not support the track yet is refused, with the remedy."""
    return f"{refused(history, predicted, measured, nis, config)}{BESIDE}"


def _priors(least: Manoeuvre) -> list[str]:
    names = ("filter.initial_velocity_sigma_m_s", "filter.initial_rate_sigma_deg_s")
    return [
        f"{name} to a third of the largest {what}"
        for name, what, factor in zip(names, ("speed", "rate"), least, strict=True)
        if 1.0 < factor < inf
    ]


def _beyond(before: FilterState, predicted: FilterState, found: Innovation) -> str:
    """Return in words how far a measured pose is from its prediction, and which distance was expected."""
    sigma = np.sqrt(np.diag(found.covariance))
    shift_m, turn_rad = (float(np.linalg.norm(found.difference[part])) for part in (POSITION, ATTITUDE))
    expected_m, expected_rad = (float(np.linalg.norm(sigma[part])) for part in (POSITION, ATTITUDE))
    step_s = (predicted.stamp_ns - before.stamp_ns) / NANOSECONDS
    return (
        f"{degrees(turn_rad):.1f} deg and {1e3 * shift_m:.0f} mm from the prediction over {step_s:.2f} s, "
        f"{degrees(expected_rad):.1f} deg and {1e3 * expected_m:.0f} mm expected"
    )
