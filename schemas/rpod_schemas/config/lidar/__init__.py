"""The LIDAR: the emulated scanner, and the parameters of the methods that estimate a pose from its scans."""

from rpod_schemas.config.lidar.scanner import (
    LidarConfig,
    LidarDetectionConfig,
    LidarNoiseConfig,
    LidarReceiverConfig,
    LidarTransmitterConfig,
    ScanPatternConfig,
)

__all__ = [
    "LidarConfig",
    "LidarDetectionConfig",
    "LidarNoiseConfig",
    "LidarReceiverConfig",
    "LidarTransmitterConfig",
    "ScanPatternConfig",
]
