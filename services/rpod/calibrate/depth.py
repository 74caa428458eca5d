"""``rpod calibrate depth`` from its arguments to its exit code."""

import json
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table

from rpod.calibrate.unreadable import print_unreadable
from rpod.errors import failed
from rpod_analysis import AnalysisError, open_log
from rpod_analysis.calibration.depth_calibration import RangeBin, evidence, fit, range_bins
from rpod_analysis.calibration.depth_samples import collect
from rpod_runtime.process.lifecycle import EXIT_OK
from rpod_schemas.config.base import load
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.config.pmd.depth_calibration import DepthCalibration
from rpod_schemas.errors import ConfigurationError


def calibrate_command(
    logs: Sequence[Path],
    *,
    camera: str,
    config: Path | None,
    check: Path | None,
    out: Path | None,
    as_json: bool,
) -> int:
    """Fit a calibration to logs, or check an existing one on them; return the exit code."""
    try:
        given = load(DepthCalibration, check) if check else None
        estimator = load(EstimatorConfig, config) if config else None
        with ExitStack() as stack:
            opened = [stack.enter_context(open_log(path)) for path in logs]
            samples = collect(opened, camera, estimator)
        calibration = (
            fit(samples) if given is None else given.model_copy(update={"evidence": evidence(samples, given)})
        )
        bins = range_bins(samples, calibration)
        written = (out or Path(f"{camera}-calibration.yaml")) if given is None else out
        if written:
            calibration.write(written)
        print_unreadable("rpod calibrate depth", *opened)
    except (ConfigurationError, AnalysisError, OSError) as error:
        return failed("calibrate depth", error)
    if as_json:
        ranges = [asdict(part) | {"bias_sigma_m": part.bias_sigma_m} for part in bins]
        found = {"file": str(written) if written else None, "ranges": ranges}
        print(json.dumps(calibration.model_dump(mode="json") | found, indent=2))
    else:
        _print(calibration, bins, written)
    return EXIT_OK


def _print(calibration: DepthCalibration, bins: Sequence[RangeBin], written: Path | None) -> None:
    console, found = Console(markup=False), calibration.evidence
    assert found is not None  # noqa: S101 - told by the caller
    console.print(_errors(calibration))
    console.print(_ranges(bins))
    console.print(
        f"bias {1e3 * found.bias_before_m:.1f} mm before, {1e3 * found.bias_after_m:.1f} mm after (RMS over "
        f"the ranges); {found.pixels} pixels of {found.frames} frames, "
        f"{found.range_m[0]:.2f} to {found.range_m[1]:.2f} m",
        highlight=False,
    )
    if written:
        console.print(f"calibration   {written}", soft_wrap=True, highlight=False)


def _errors(calibration: DepthCalibration) -> Table:
    table = Table(title="measured minus true distance", title_justify="left")
    for name in ("term", "period", "height, mm", "cos, mm", "sin, mm", "sigma, mm"):
        table.add_column(name, justify="left" if name == "term" else "right")
    offset_mm, sigma_mm = 1e3 * calibration.offset_m, 1e3 * calibration.offset_sigma_m
    table.add_row("offset", "", f"{offset_mm:.2f}", "", "", f"{sigma_mm:.2f}")
    for wave in calibration.harmonics:
        table.add_row(
            f"order {wave.order} at {wave.modulation_frequency_hz / 1e6:g} MHz",
            f"{wave.period_m:.2f} m",
            *(f"{1e3 * value:.2f}" for value in (wave.amplitude_m, wave.cos_m, wave.sin_m, wave.sigma_m)),
        )
    return table


def _ranges(bins: Sequence[RangeBin]) -> Table:
    table = Table(title="by true distance", title_justify="left")
    for name in ("range, m", "pixels", "bias before, mm", "bias after, mm", "+-", "noise, mm"):
        table.add_column(name, justify="right")
    for part in bins:
        values = part.bias_before_m, part.bias_after_m, part.bias_sigma_m, part.noise_m
        table.add_row(
            f"{part.from_m:.2f} to {part.to_m:.2f}",
            str(part.pixels),
            *(f"{1e3 * value:.1f}" for value in values),
        )
    return table
