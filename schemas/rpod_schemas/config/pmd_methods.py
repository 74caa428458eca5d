"""The path under which plugins import the parameters of depth methods; they are in ``config.pmd.methods``."""

from rpod_schemas.config.pmd.methods import IcpReverseCalibrationConfig, SignedDistanceConfig

__all__ = ["IcpReverseCalibrationConfig", "SignedDistanceConfig"]
