"""The estimator: its sensors and navigator, its filter, its models of motion, and its integrity monitor."""

from rpod_schemas.config.estimator.estimator import (
    EstimatorConfig,
    EstimatorSettings,
    LidarInput,
    NavigatorConfig,
    PmdInput,
)

__all__ = ["EstimatorConfig", "EstimatorSettings", "LidarInput", "NavigatorConfig", "PmdInput"]
