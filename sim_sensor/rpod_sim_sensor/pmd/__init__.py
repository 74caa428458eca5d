"""A PMD camera: an exposure's four samples, and depth and amplitude from them."""

from rpod_sim_sensor.pmd.emulator import PmdEmulator, PmdExposure, PoseCountError
from rpod_sim_sensor.pmd.reconstruction import amplitude, distance, phase, reconstruct

__all__ = [
    "PmdEmulator",
    "PmdExposure",
    "PoseCountError",
    "amplitude",
    "distance",
    "phase",
    "reconstruct",
]
