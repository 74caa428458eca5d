"""Detection of a laser pulse: the model of the 2015 paper, equation by equation.

Source: Opromolla et al., Sensors 15(3), 2015, section 3.2, Eqs. 4 to 9. Powers and electrons are those
of one pulse. All arrays broadcast; a result has the shape that they have together.
"""

from math import log, pi, sqrt
from typing import Literal

import numpy as np
from scipy import constants
from scipy.special import erf

from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.lidar import (
    LidarConfig,
    LidarDetectionConfig,
    LidarReceiverConfig,
    LidarTransmitterConfig,
)


def detection_probability(
    snr: FloatArray, false_alarm: float, threshold: Literal["usual", "printed"] = "usual"
) -> FloatArray:
    """Return P_D (Eq. 4) of signal-to-noise ratios, in their shape.

    Args:
        snr: signal over the noise's standard deviation, any shape.
        false_alarm: probability of a false alarm.
        threshold: the usual one, or that which the paper prints.
    """
    logarithm = log(1.0 / false_alarm)
    level = 0.5 * logarithm if threshold == "printed" else sqrt(logarithm)
    return 0.5 * (1.0 + erf(np.sqrt(0.5 + snr) - level))


def electrons(
    power_W: FloatArray, laser: LidarTransmitterConfig, receiver: LidarReceiverConfig
) -> FloatArray:
    """Return the mean photoelectrons of a power that falls on the detector during a pulse (Eq. 5)."""
    photon_J = constants.h * constants.c / laser.wavelength_m
    return receiver.quantum_efficiency * power_W * laser.pulse_width_s / photon_J


def echo_power_W(  # noqa: N802 - watts
    reflectivity: FloatArray,
    cos_incidence: FloatArray,
    range_m: FloatArray,
    laser: LidarTransmitterConfig,
    receiver: LidarReceiverConfig,
) -> FloatArray:
    """Return the power of the echo of a resolved Lambertian target at the detector (Eq. 6)."""
    peak_power_W = laser.average_power_W / (laser.pulse_rate_hz * laser.pulse_width_s)
    collected = reflectivity * cos_incidence * receiver.aperture_m**2 / (4.0 * range_m**2)
    return peak_power_W * collected * receiver.transmittance


def thermal_variance(receiver: LidarReceiverConfig) -> float:
    """Return the variance of the thermal noise electrons, Q_n^2 (Eq. 7)."""
    energy_J = constants.k * receiver.temperature_K
    return energy_J * receiver.capacitance_F / constants.e**2


def background_power_W(  # noqa: N802 - watts
    reflectivity: FloatArray, laser: LidarTransmitterConfig, receiver: LidarReceiverConfig
) -> FloatArray:
    """Return the sunlight that reaches the filter, Pw_BACK of Eq. 8, for which the paper has no formula.

    The sunlit target has the radiance rho E / pi within the filter's band; the aperture collects it from
    a field of view as wide as the beam.
    """
    irradiance_W_m2 = receiver.sun_irradiance_W_m2_nm * receiver.filter_bandwidth_nm
    aperture_m2 = pi * receiver.aperture_m**2 / 4.0
    field_of_view_sr = pi * laser.beam_divergence_rad**2 / 4.0
    return reflectivity * (irradiance_W_m2 / pi * aperture_m2 * field_of_view_sr)


def background_electrons(
    reflectivity: FloatArray, laser: LidarTransmitterConfig, receiver: LidarReceiverConfig
) -> FloatArray:
    """Return the mean, and variance, of the photoelectrons that carry no range, N_b (Eq. 8)."""
    sunlight = electrons(background_power_W(reflectivity, laser, receiver), laser, receiver)
    dark = receiver.dark_current_A * laser.pulse_width_s / constants.e
    return receiver.transmittance * sunlight + dark


def signal_to_noise(
    signal_e: FloatArray,
    background_e: FloatArray,
    detection: LidarDetectionConfig,
    receiver: LidarReceiverConfig,
) -> FloatArray:
    """Return the signal over the noise's standard deviation (Eq. 9), N_Sig and N_b multiplied by the gain.

    The options of ``detection`` add the signal's shot noise and the avalanche's gain on a variance.
    """
    gain = receiver.gain
    on_variance = gain if detection.gain_on_variance == "linear" else gain**2 * detection.excess_noise_factor
    shot_e = background_e + signal_e if detection.shot_noise else background_e
    return gain * signal_e / np.sqrt(thermal_variance(receiver) + on_variance * shot_e)


def echo(
    config: LidarConfig, *, reflectivity: FloatArray, cos_incidence: FloatArray, range_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the mean signal electrons N_Sig of rays that meet a surface, and their P_D; NaN for others.

    Args:
        config: the LIDAR.
        reflectivity: of the surface that each ray meets, any shape, which is that of the other arguments
            and of both results.
        cos_incidence: cosine of the angle between ray and normal.
        range_m: range, NaN for a ray that meets nothing.
    """
    laser, receiver, detection = config.transmitter, config.receiver, config.detection
    power_W = echo_power_W(reflectivity, cos_incidence, range_m, laser, receiver)
    signal_e = electrons(power_W, laser, receiver)
    background_e = background_electrons(reflectivity, laser, receiver)
    if detection.returned == "all":
        return signal_e, np.where(np.isnan(range_m), np.nan, 1.0)
    snr = signal_to_noise(signal_e, background_e, detection, receiver)
    return signal_e, detection_probability(snr, detection.false_alarm, detection.threshold)
