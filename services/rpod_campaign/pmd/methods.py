"""Methods for the camera under trial, by the names of the command line."""

from typing import Any

from rpod_schemas.config.acceptance import AcceptanceConfig
from rpod_schemas.config.base import check
from rpod_schemas.config.estimator import PmdInput
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.sensors import methods

PAPER_ICP = "icp-reverse-calibration"
_VARIANTS: dict[str, dict[str, Any]] = {
    PAPER_ICP: {
        "kind": "icp_reverse_calibration",
        "metric": "point_to_point",
        "iterations": 60,
        "step_m": 0.0005,
    },
    "icp-reverse-calibration-plane": {"kind": "icp_reverse_calibration"},
}
"""Fields of the 2018 paper's ICP, point to point with equal weights in many small steps, and of ours, point
to plane."""
EVERY_POSE = AcceptanceConfig(max_cost_m2=1e9, min_explained_share=0.0, min_inlier_share=0.0)
"""Limits that every pose meets."""
DEFAULT = "default"
"""Name of the method in the facility's default configuration."""


def has_radius(method: str) -> bool:
    """Return whether a method searches for neighbours in a radius."""
    return method in _VARIANTS


def method_names() -> tuple[str, ...]:
    """Return the methods that ``--method`` accepts: the variants above, and all of installed packages."""
    brought = (each.name.replace("_", "-") for each in methods("pmd", "tracking"))
    return tuple(dict.fromkeys((*_VARIANTS, *brought)))


def pmd_input(
    method: str, *, radius_px: int | None = None, name: str = "pmd", limited: bool = True
) -> PmdInput:
    """Return the configuration of a method for the camera of a name.

    Args:
        method: name of the method.
        radius_px: radius of its neighbour search; None for the default.
        name: name of the camera.
        limited: whether a method that accepts poses by their residuals keeps its limits. A comparison with a
            paper that follows every pose needs none.

    Raises:
        ConfigurationError: the method is not known.
    """
    if method == DEFAULT:
        return PmdInput(name=name)
    known = method_names()
    if method.replace("_", "-") not in known:
        raise ConfigurationError("--method", "", f"needs {', '.join(known)}, not {method!r}")
    tracking = _VARIANTS.get(method) or {"kind": method.replace("-", "_")}
    radius = {} if radius_px is None else {"radius_px": radius_px}
    camera = check(PmdInput, {"name": name, "tracking": tracking | radius}, source=f"--method {method}")
    return camera if limited else camera.model_copy(update={"tracking": _without_limits(camera.tracking)})


def _without_limits(tracking: Any) -> Any:
    """Return a method's configuration with no limit of residuals, in itself or in its tuning."""
    if isinstance(getattr(tracking, "acceptance", None), AcceptanceConfig):
        return tracking.model_copy(update={"acceptance": EVERY_POSE})
    if hasattr(tracking, "tuning"):
        return tracking.model_copy(update={"tuning": _without_limits(tracking.tuning)})
    return tracking
