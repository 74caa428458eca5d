"""Signed distance under another name, from another package."""

from rpod_schemas.config.sensor import MethodConfig
from rpod_schemas.sensors import Method


class MyDistanceConfig(MethodConfig):
    """Depth points in the target's distance field."""

    kind: str = "my_distance"
    scales_m: tuple[float, ...] = (0.1, 0.08, 0.064, 0.051, 0.041, 0.03, 0.03, 0.03)


METHOD = Method("pmd", "tracking", MyDistanceConfig, "my_distance.tracker:MyDistance")
