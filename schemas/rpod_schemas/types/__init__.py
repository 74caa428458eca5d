"""The domain types that services work with after a message has been checked.

Arrays are views of the received bytes if the layout allows it, so that they may be read-only. Stamps are
nanoseconds of UTC since the Unix epoch (ICD section 1).
"""

from rpod_schemas.types.base import ZERO_6X6, Float32Array, Floats, Image, Model, Stamped
from rpod_schemas.types.estimates import (
    LOST_AFTER_S,
    BeliefLevel,
    EstimateValidity,
    EstimatorStatus,
    Hypothesis,
    Integrity,
    IntegrityState,
    Mode,
    Source,
)
from rpod_schemas.types.frames import LENS_COEFFICIENTS, Camera, FrameImage, SensorFrame, SensorInfo
from rpod_schemas.types.health import CLOSING, PUBLISHED, SYNC, Diagnostic, Health, SensorSync
from rpod_schemas.types.lidar import LidarInfo, LidarScan
from rpod_schemas.types.motion import Command, ImuReading, Joints, Odometry
from rpod_schemas.types.pmd import PmdFrame, PmdInfo

__all__ = [
    "CLOSING",
    "LENS_COEFFICIENTS",
    "LOST_AFTER_S",
    "PUBLISHED",
    "SYNC",
    "ZERO_6X6",
    "BeliefLevel",
    "Camera",
    "Command",
    "Diagnostic",
    "EstimateValidity",
    "EstimatorStatus",
    "Float32Array",
    "Floats",
    "FrameImage",
    "Health",
    "Hypothesis",
    "Image",
    "ImuReading",
    "Integrity",
    "IntegrityState",
    "Joints",
    "LidarInfo",
    "LidarScan",
    "Mode",
    "Model",
    "Odometry",
    "PmdFrame",
    "PmdInfo",
    "SensorFrame",
    "SensorInfo",
    "SensorSync",
    "Source",
    "Stamped",
]
