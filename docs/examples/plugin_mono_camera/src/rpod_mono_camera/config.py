"""Configuration of the camera, of the estimator's side, and of the methods."""

import math
from typing import Annotated, Literal

from pydantic import Field
from scipy import constants

from rpod_schemas.config.base import Config, Name, NonNegative, Positive, Share
from rpod_schemas.config.sensor import EmulatedSensor, MethodConfig, SensorInput
from rpod_schemas.sensors.fields import chosen
from rpod_schemas.types import Camera

WAVELENGTH_M = 550e-9
"""Middle of the visible band."""


class MonoPixelConfig(Config):
    """The sensor chip: a typical machine-vision CMOS of 12 bits (assumed)."""

    pitch_m: Positive = 5.5e-6
    """Side of the sensitive square."""
    quantum_efficiency: Share = 0.55
    """Electrons per photon."""
    full_well_e: Positive = 12000.0
    """Electrons at which a pixel saturates, and the converter's last count."""
    read_noise_e: NonNegative = 8.0
    """Standard deviation of a pixel as it is read."""
    dark_e_s: NonNegative = 50.0
    """Dark current."""
    nonuniformity_share: Share = 0.01
    """Standard deviation of the pixels' responses, fixed for a camera."""
    black_share: Share = 0.01
    """Level of a pixel without light, as a share of the last count."""
    bits: Literal[8, 12] = 12
    """Resolution of the converter: 8 bits give ``mono8``, 12 give ``mono16``."""


class MonoConfig(EmulatedSensor):
    """An emulated monocular camera."""

    kind: str = "mono"
    """Selects this sensor."""
    name: Name = "mono"
    """Prefix of its topics, and of its frame ``<name>_optical``."""
    rate_hz: Positive = 10.0
    """Frames per second."""
    camera: Camera = Camera(width=640, height=480, fx=900.0, fy=900.0, cx=319.5, cy=239.5)
    """Intrinsics, plumb_bob distortion included."""
    exposure: Literal["fixed", "automatic"] = "automatic"
    """automatic: shorter where the very frame's light would fill the pixels."""
    exposure_s: Positive = 0.005
    """Integration time, the longest where the exposure is automatic."""
    readout_s: NonNegative = 0.01
    """From the end of the exposure to the frame's hand-over."""
    f_number: Positive = 4.0
    """Focal length over aperture."""
    transmission: Share = 0.8
    """Transmission of the lens in the visible band."""
    sun_share: Share = 0.4
    """Share of the sun's irradiance in the band: 400 to 700 nm have about 530 of 1361 W/m2."""
    blur_px: NonNegative = 0.7
    """Standard deviation of the lens's point spread."""
    subsamples: Annotated[int, Field(ge=1, le=8)] = 2
    """Rays across a pixel, and down."""
    pixel: MonoPixelConfig = MonoPixelConfig()
    """The sensor chip."""

    @property
    def latency_s(self) -> float:
        """From the stamp, the middle of the exposure, to the hand-over."""
        return 0.5 * self.exposure_s + self.readout_s

    @property
    def electrons_per_radiance_s(self) -> float:
        """Electrons of a pixel in a second for 1 W/m2/sr: pi / (4 N^2) tau A QE / (h nu)."""
        photon_J = constants.h * constants.c / WAVELENGTH_M
        irradiance = math.pi / (4.0 * self.f_number**2) * self.transmission
        return irradiance * self.pixel.pitch_m**2 * self.pixel.quantum_efficiency / photon_J


class EdgeTrackingConfig(MethodConfig):
    """The target's wireframe, searched along its normals in the image."""

    kind: str = "edges"
    """Selects this method."""
    blur_px: Positive = 0.8
    """Standard deviation of the smoothing before the search."""
    search_px: Positive = 14.0
    """Reach of the search both ways in the first step."""
    final_search_px: Positive = 2.5
    """Reach of the search in the last step."""
    steps: Annotated[int, Field(ge=3)] = 8
    """Gauss-Newton steps, over which the reach narrows geometrically."""
    min_contrast: Share = 0.04
    """Least change of brightness over two pixels, as a share of the target's median brightness."""
    min_edges: Annotated[int, Field(ge=6)] = 40
    """Fewer edge samples in their place are no registration."""
    min_found_share: Share = 0.4
    """Least share of the visible edge samples that are found in their place."""
    sigma_px: Positive = 0.15
    """Least standard deviation of an edge's place."""
    effective_edges: Positive = 30.0
    """Most samples counted as independent: those of an edge share the shading beside it, and some thirty
    edges of a satellite are seen at once (an assumption, not fitted)."""


class NearPredictionConfig(MethodConfig):
    """Tracking with a wide search around a prediction; finds nothing without one."""

    kind: str = "near_prediction"
    """Selects this method."""


class MonoInput(SensorInput):
    """A monocular camera and the methods for it."""

    kind: str = "mono"
    """Which methods."""
    name: Name = "mono"
    """Name of the sensor: the first part of its topics."""
    acquisition: Annotated[MethodConfig, chosen("mono", "acquisition")] = Field(
        default_factory=NearPredictionConfig
    )
    """Without a prior pose."""
    tracking: Annotated[MethodConfig, chosen("mono", "tracking")] = Field(default_factory=EdgeTrackingConfig)
    """From a predicted pose."""
