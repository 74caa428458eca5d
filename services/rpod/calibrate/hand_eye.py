"""``rpod calibrate mount`` and ``rpod calibrate clock`` from their arguments to their exit codes."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import yaml

from rpod.calibrate.unreadable import print_unreadable
from rpod.errors import failed
from rpod_analysis import AnalysisError, open_log
from rpod_analysis.calibration.hand_eye.fit import fit_hand_eye
from rpod_analysis.calibration.hand_eye.logged import LoggedPoses, poses_of
from rpod_analysis.calibration.hand_eye.parameters import Assumptions
from rpod_analysis.calibration.hand_eye.results import (
    clock_findings,
    clock_source,
    holder_findings,
    mount_calibration,
    mount_findings,
    warnings_of,
)
from rpod_analysis.errors import CalibrationError
from rpod_runtime.process.lifecycle import EXIT_OK
from rpod_schemas.config.base import load
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.poses import rotation_matrix


@dataclass(frozen=True, eq=False)
class _Found:
    """Result of a verb: the lines for the operator, the JSON object, and the file."""

    lines: Sequence[str]
    document: dict[str, Any]
    write: Callable[[Path], object]
    default: Path


def hand_eye_command(
    verb: Literal["mount", "clock"],
    path: Path,
    sensor: str | None,
    *,
    config: Path | None,
    depth_sigma_mm: float | None,
    out: Path | None,
    as_json: bool,
) -> int:
    """Find the mount or the clock of a log's sensor by hand-eye calibration; return the exit code."""
    try:
        measuring = load(EstimatorConfig, config) if config else None
        with open_log(path) as log:
            poses = poses_of(log, sensor, measuring)
            depth_sigma_m = poses.depth_sigma_m if depth_sigma_mm is None else 1e-3 * depth_sigma_mm
            find = _mount if verb == "mount" else _clock
            found = find(poses, Assumptions(depth_sigma_m), path.name)
            print_unreadable(f"rpod calibrate {verb}", log)
        file = out or found.default
        found.write(file)
    except (ConfigurationError, AnalysisError, OSError) as error:
        return failed(f"calibrate {verb}", error)
    if as_json:
        print(json.dumps(found.document | {"file": str(file), "findings": list(found.lines)}, indent=2))
    else:
        print("\n".join([*found.lines, f"{verb:13} {file}"]))
    return EXIT_OK


def _mount(poses: LoggedPoses, assumed: Assumptions, log: str) -> _Found:
    found = fit_hand_eye(poses.measured, poses.truth, assumed)
    calibration = mount_calibration(found, poses, log=log)
    lines = [*mount_findings(found, poses), *holder_findings(found), *clock_findings(found)]
    return _Found(
        [*lines, *warnings_of(found, poses)],
        calibration.model_dump(mode="json"),
        calibration.write,
        Path(f"{poses.sensor.name}-mount.yaml"),
    )


def _clock(poses: LoggedPoses, assumed: Assumptions, _log: str) -> _Found:
    kept = ""
    try:
        found = fit_hand_eye(poses.measured, poses.truth, assumed)
    except CalibrationError as error:
        if poses.sensor.T_chaser_sensor is None:
            raise
        mount = poses.sensor.T_chaser_sensor
        held = Assumptions(assumed.depth_sigma_m, mount=(rotation_matrix(mount), mount.translation))
        found = fit_hand_eye(poses.measured, poses.truth, held)
        kept = f"the mount is kept as in the log, since {error}"
    source = clock_source(found, poses)
    told = [*clock_findings(found), *warnings_of(found, poses), *([kept] if kept else [])]
    comment = "".join(f"# {line}\n" for line in told)
    text = comment + yaml.safe_dump(source.model_dump(mode="json", exclude_defaults=True), sort_keys=False)
    document = {
        "clock_offset_s": source.clock_offset_s,
        "found_offset_s": found.state.offset_s,
        "sigma_s": found.offset_sigma_s,
        "drift_ppm": 1e6 * found.state.drift,
        "drift_sigma_ppm": 1e6 * found.drift_sigma,
        "at_stamp_ns": found.middle_ns,
        "source": source.model_dump(mode="json"),
    }
    return _Found(
        told,
        document,
        lambda path: path.write_text(text, encoding="utf-8"),
        Path(f"{poses.sensor.name}-source.yaml"),
    )
