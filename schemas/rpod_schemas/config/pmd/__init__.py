"""The PMD camera: the emulated camera, its calibration, and the parameters of the methods for its frames."""

from rpod_schemas.config.pmd.camera import (
    MAX_RATE_HZ,
    MODULATION_FREQUENCIES_HZ,
    SAMPLE_OFFSET,
    SAMPLES,
    PmdConfig,
)

__all__ = ["MAX_RATE_HZ", "MODULATION_FREQUENCIES_HZ", "SAMPLES", "SAMPLE_OFFSET", "PmdConfig"]
