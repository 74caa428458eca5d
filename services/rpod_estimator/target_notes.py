"""What an operator should know of the target's file before the first frame."""

import logging
from typing import Any

from rpod_pose.methods import kind_methods
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_target import Target
from rpod_target.mesh.topology import areas_m2

log = logging.getLogger(__name__)


def tell_of_target(config: EstimatorConfig, target: Target) -> None:
    """Log which parts are ignored, and whether the errors of the edges were measured where that counts."""
    _tell_unreliable_parts(config, target)
    _tell_unmeasured_edges(config, target)


def _tell_unreliable_parts(config: EstimatorConfig, target: Target) -> None:
    reliable = target.reliable
    if reliable is None:
        return
    parts = [name for name in target.parts if name not in reliable.parts]
    area_m2, left_m2 = (areas_m2(each.triangles_m).sum() for each in (target, reliable))
    log.warning(
        "unreliable parts are ignored: %s, %.0f %% of the surface; to use them, change %s",
        ", ".join(parts),
        100.0 * (1.0 - left_m2 / area_m2),
        target.source,
    )
    for sensor in config.sensors:
        if kind_methods(sensor).masked is None:
            text = "%s: unreliable parts are not ignored: sensors of kind %s cannot remove their points"
            log.warning(text, sensor.name, sensor.kind)


def _tell_unmeasured_edges(config: EstimatorConfig, target: Target) -> None:
    if target.camera_errors is not None or config.filter.errors != "considered":
        return
    trackers: dict[str, Any] = {each.name: getattr(each, "tracking", None) for each in config.sensors}
    names = [name for name, tracking in trackers.items() if getattr(tracking, "kind", "") == "joint"]
    if names:
        log.info(
            "%s: errors of the target's edges were not measured, the covariance may be too small: "
            "'rpod target errors %s' measures them",
            ", ".join(names),
            target.source,
        )
