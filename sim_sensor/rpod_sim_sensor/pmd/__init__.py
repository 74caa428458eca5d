"""The emulated PMD camera: samples of an exposure, and depth and amplitude from them."""

from rpod_sim_sensor.pmd.emulator import PmdEmulator, PmdExposure, PoseCountError
from rpod_sim_sensor.pmd.reconstruction import (
    Lost,
    Reconstruction,
    amplitude,
    asymmetry,
    distance,
    phase,
    reconstruct,
)
from rpod_sim_sensor.pmd.unwrapping import unwrap

__all__ = [
    "Lost",
    "PmdEmulator",
    "PmdExposure",
    "PoseCountError",
    "Reconstruction",
    "amplitude",
    "asymmetry",
    "distance",
    "phase",
    "reconstruct",
    "unwrap",
]
