"""Refusal of frames whose sensor has another setup than in the frames that the running track has used.

A mount that moves by a metre moves the estimate by a metre, and no measurement of this sensor shows it. The
estimator cannot know which of the two setups is right. So the operator decides, by a reset or by a policy.
"""

from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_runtime.sensor_data.extrinsics import apart, differ
from rpod_schemas.errors import MessageRejectedError, Reason

_MAY_CHANGE = frozenset({"integration_time_s"})
"""Fields of an info that a sensor changes by itself, like its exposure time."""
_SHOWN = 4
"""Largest number of values of a field that a message lists."""


class Setup(NamedTuple):
    """Data of a sensor that are not in its frames."""

    T_chaser_sensor: RigidTransform
    info: Any
    """Info message of the sensor; None if it sends none."""


class SetupCheck:
    """Remembers the setup of each sensor in the last frame that was used."""

    def __init__(self) -> None:
        self._known: dict[str, Setup] = {}

    def check(self, sensor: str, setup: Setup, *, source: object, pinned: bool) -> None:
        """Note a frame's setup, or refuse it.

        Args:
            sensor: name of the sensor.
            setup: setup of the sensor for this frame.
            source: publisher of the frame, for the operator.
            pinned: whether the setup must equal that of the earlier frames, if there are any.

        Raises:
            MessageRejectedError: the setup is pinned and differs; the text says what changed, by how much.
        """
        known = self._known.setdefault(sensor, setup)
        if pinned and (changed := _difference(known, setup)):
            raise MessageRejectedError(
                Reason.OTHER_SETUP,
                f"{changed} since tracking began, frames of {source}; `reset` the estimator if the new one "
                "is right, stop its publisher if not",
            )
        self._known[sensor] = setup

    def info(self, sensor: str, newest: Any) -> Any:
        """Return the info of the last frame that was used; ``newest`` if there was none."""
        known = self._known.get(sensor)
        return newest if known is None or known.info is None else known.info

    def forget(self) -> None:
        """Accept any setup from now on."""
        self._known.clear()


def _difference(known: Setup, setup: Setup) -> str:
    if differ(known.T_chaser_sensor, setup.T_chaser_sensor):
        return f"the mount has moved by {apart(known.T_chaser_sensor, setup.T_chaser_sensor)}"
    if known.info is None or known.info is setup.info:
        return ""
    before, now = dict(known.info), dict(setup.info)
    for field, value in before.items():
        if field not in _MAY_CHANGE and not np.array_equal(value, now[field]):
            return f"{field} of the sensor's info has changed from {_text(value)} to {_text(now[field])}"
    return ""


def _text(value: Any) -> str:
    if value is None:
        return "none"
    values = np.atleast_1d(value)
    return ", ".join(f"{each:g}" for each in values) if values.size <= _SHOWN else f"{values.size} values"
