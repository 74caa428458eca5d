"""The emulated scanning LIDAR: geometry, detection and noise of the 2015 paper."""

from rpod_sim_sensor.lidar.emulator import LidarEmulator, LidarReturns

__all__ = ["LidarEmulator", "LidarReturns"]
