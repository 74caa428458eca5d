"""The recorded buffer of an ifm O3R in docs/examples/ifm, and what a head's SDK makes of such images."""

from pathlib import Path

from rpod_driver.adapters.ifm.config import IfmConfig

FOLDER = Path(__file__).parents[1] / "docs" / "examples" / "ifm"
BUFFER, TOF_INFO, LENS = FOLDER / "O3RBuffer.data", FOLDER / "tof_info.data", FOLDER / "lens.yaml"
TOF_INFO_HEADER_BYTES = 16
"""Length of what stands before the structure in the file."""


def tof_info_bytes() -> bytes:
    """Return a TOF_INFO of version 4."""
    return TOF_INFO.read_bytes()[TOF_INFO_HEADER_BYTES:]


def configuration(**device: object) -> IfmConfig:
    """Return the configuration of a recording; the buffer in the repository unless told otherwise."""
    told = {"recording": str(BUFFER), "calibration": str(LENS)} | device
    return IfmConfig.model_validate({"name": "front", "device": told})
