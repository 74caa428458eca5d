"""What the camera's campaigns share: their options, their cells, and what they say of a sequence."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import polars as pl

from rpod_analysis.score import NEES_95
from rpod_campaign.engine.campaign import CellResult, Options
from rpod_campaign.engine.statistics import mean, quantile
from rpod_campaign.pmd.methods import has_radius, pmd_input
from rpod_campaign.pmd.sequence import SequenceCell
from rpod_schemas.config.base import check
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.config.scenario import Scenario
from rpod_schemas.errors import ConfigurationError

Results = Sequence[CellResult[SequenceCell]]

AXES = ("roll_deg", "pitch_deg", "yaw_deg", "x_m", "y_m", "z_m")
"""Of the errors: attitude in target axes, position in the sensor's (ICD section 1)."""
OTHER_AXES = (
    "sensor_roll_deg", "sensor_pitch_deg", "sensor_yaw_deg", "target_x_m", "target_y_m", "target_z_m",
)  # fmt: skip
"""The same errors the other way round: attitude in the sensor's axes, position in the target's."""
CALIBRATED_WIGGLING = 0.005
"""What a calibration of the depth leaves of the third harmonic."""
_FAMILY = "mockup-"


def scenarios(options: Options, default: tuple[str, ...]) -> Iterator[tuple[str, Scenario]]:
    """Yield the scenarios with a camera; ``mockup-`` need not be said. Raises ConfigurationError."""
    known = {
        name.removeprefix(_FAMILY): scenario
        for name, scenario in options.scenarios.items()
        if any(isinstance(sensor, PmdConfig) for sensor in scenario.sensors)
    }
    for name in options.scenario or default:
        short = name.removeprefix(_FAMILY)
        if short not in known:
            raise ConfigurationError("--scenario", "", f"needs {', '.join(known)}, not {name!r}")
        yield short, known[short]


def methods(
    options: Options, default: tuple[str, ...], *, radii_px: tuple[int, ...] = (25,)
) -> Iterator[tuple[str, int | None]]:
    """Yield methods, each with its radii of the neighbour search where it has one.

    Raises:
        ConfigurationError: a method is unknown, or this version lacks it.
    """
    chosen = options.method or default
    if options.radius and not any(has_radius(method) for method in chosen):
        raise ConfigurationError("--radius", "", f"has no meaning for {', '.join(chosen)}")
    for method in chosen:
        for radius_px in (options.radius or radii_px) if has_radius(method) else (None,):
            pmd_input(method, radius_px=radius_px)
            yield method, radius_px


def calibrated(scenario: Scenario) -> Scenario:
    """Return a scenario whose cameras have the error that a calibration leaves, which the estimator knows."""
    document: dict[str, Any] = scenario.model_dump(mode="json")
    hertz = {}
    for camera, sensor in zip(scenario.sensors, document["sensors"], strict=True):
        if isinstance(camera, PmdConfig):
            sensor["pixel"]["wiggling_share"] = CALIBRATED_WIGGLING
            hertz[camera.name] = camera.frequencies_hz
    for sensor in document["estimator"]["sensors"]:
        if sensor["kind"] == "pmd":
            sensor["calibration"] = {"modulation_frequency_hz": hertz[sensor["name"]]}
    return check(Scenario, document, source=scenario.name)


def summarise(cell: SequenceCell, rows: pl.DataFrame) -> dict[str, Any]:
    """Return what is said of a sequence; RMS over all frames, those where the last pose stayed included."""
    known = rows.filter(pl.col("nees").is_finite())["nees"]
    return {
        "scenario": cell.scenario,
        "method": cell.method,
        "radius_px": cell.radius_px,
        "frames": rows.height,
        "rms": rms(rows),
        "norms": {"attitude_deg": _rms(rows["attitude_deg"]), "position_m": _rms(rows["position_m"])},
        "max": {name: quantile(rows[name], 1.0) for name in ("attitude_deg", "position_m")},
        "median_s": quantile(rows["track_s"], 0.5),
        "p95_s": quantile(rows["track_s"], 0.95),
        "lost": int((rows["off_target"] | ~rows["measured"]).sum()),
        "lost_without_pose": int((~rows["measured"]).sum()),
        "lost_off_target": int(rows["off_target"].sum()),
        "nees_mean": mean(known),
        "nees_share_in_95": mean((known <= NEES_95).cast(pl.Float64)),
        "depth_share": mean(rows["depth_share"]),
        "sequence": cell.frames,
        "through": cell.through,
        "case": cell.case,
    }


def rms(rows: pl.DataFrame, axes: tuple[str, ...] = AXES) -> dict[str, float | None]:
    """Return the RMS error along axes, None of no rows."""
    names = (name.removeprefix("sensor_").removeprefix("target_") for name in axes)
    return {name: _rms(rows[axis]) for name, axis in zip(names, axes, strict=True)}


def _rms(values: pl.Series) -> float | None:
    return float(np.sqrt(np.mean(values.to_numpy() ** 2))) if values.len() else None
