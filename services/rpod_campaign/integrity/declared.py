"""Errors of mount, clock and ranges that a nominal run has, as large as they are declared for a sensor.

The protection levels contain a declared standard deviation of each of these errors. So the errors with which
levels are compared must contain them too. Without them a level would look too large.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_campaign.engine.trial.streams import stream
from rpod_campaign.integrity.ranges import with_longer_ranges
from rpod_pose.measurement import Measurement
from rpod_schemas.config.estimator.integrity import IntegrityConfig
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.poses import make_pose

_DECLARED = 23
"""Stream of random numbers."""


@dataclass(frozen=True, eq=False)
class DeclaredErrors:
    """Errors of a sensor that stay the same throughout a sequence."""

    of_mount: RigidTransform
    """The stated mount is the true one times this pose."""
    late_s: float
    """Time by which the stamps are late, s."""
    range_scale: float
    """Measured range over the true one."""

    @classmethod
    def drawn(cls, config: IntegrityConfig, *, seed: int, trial: int, sensor: str) -> Self:
        """Return errors with the declared standard deviations, the same for each fault of a trial."""
        generator = stream(seed, trial, _DECLARED + ("lidar", "pmd").index(sensor))
        turn, place, late, longer = np.split(generator.standard_normal(8), [3, 6, 7])
        return cls(
            make_pose(
                rotation=Rotation.from_rotvec(config.mount_sigma_deg * turn, degrees=True),
                translation_m=config.mount_sigma_m * place,
            ),
            late_s=config.clock_sigma_s * float(late[0]),
            range_scale=1.0 + config.tuning.range_share * float(longer[0]),
        )

    def measured(self, clean: Measurement) -> Measurement:
        """Return a measurement with these errors."""
        data = with_longer_ranges(clean.data, scale=self.range_scale)
        stamp_ns = data.stamp_ns + round(self.late_s * NANOSECONDS)
        return replace(
            clean,
            data=data.model_copy(update={"stamp_ns": stamp_ns}),
            T_chaser_sensor=clean.T_chaser_sensor * self.of_mount,
        )
