"""A tracking method of one's own: signed distance under another name."""

from rpod_schemas.config.pmd.methods import SignedDistanceConfig
from rpod_schemas.sensors import Method


class MyDistanceConfig(SignedDistanceConfig):
    """Parameters: those of ``signed_distance``; add yours."""

    kind: str = "my_distance"


METHOD = Method("pmd", "tracking", MyDistanceConfig, "my_distance.tracker:build")
