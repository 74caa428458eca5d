"""``rpod calibrate mount`` and ``rpod calibrate clock`` from their arguments to their exit codes."""

import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from rpod.unreadable import tell_unreadable
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
from rpod_runtime.lifecycle import EXIT_FAILURE, EXIT_OK, EXIT_USAGE
from rpod_schemas.config.base import load
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.poses import rotation_matrix
from rpod_target import TargetError


@dataclass(frozen=True, eq=False)
class _Found:
    """Result of a verb: what is told, what is printed as JSON, and the file."""

    lines: Sequence[str]
    document: dict[str, Any]
    write: Callable[[Path], object]
    default: Path


def mount_command(
    log: Path,
    sensor: str | None,
    *,
    config: Path | None,
    depth_sigma_mm: float | None,
    out: Path | None,
    as_json: bool,
) -> int:
    """Find a sensor's mount from a log; return the exit code."""

    def find(poses: LoggedPoses) -> _Found:
        found = fit_hand_eye(poses.measured, poses.truth, _assumed(poses, depth_sigma_mm))
        calibration = mount_calibration(found, poses, log=log.name)
        lines = [*mount_findings(found, poses), *holder_findings(found), *clock_findings(found)]
        return _Found(
            [*lines, *warnings_of(found, poses)],
            calibration.model_dump(mode="json"),
            calibration.write,
            Path(f"{poses.sensor.name}-mount.yaml"),
        )

    return _run("mount", find, log, sensor, config=config, out=out, as_json=as_json)


def clock_command(
    log: Path,
    sensor: str | None,
    *,
    config: Path | None,
    depth_sigma_mm: float | None,
    out: Path | None,
    as_json: bool,
) -> int:
    """Find the offset and drift of a sensor's clock from a log; return the exit code."""

    def find(poses: LoggedPoses) -> _Found:
        assumed = _assumed(poses, depth_sigma_mm)
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
        text = comment + yaml.safe_dump(
            source.model_dump(mode="json", exclude_defaults=True), sort_keys=False
        )
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

    return _run("clock", find, log, sensor, config=config, out=out, as_json=as_json)


def _assumed(poses: LoggedPoses, depth_sigma_mm: float | None) -> Assumptions:
    return Assumptions(poses.depth_sigma_m if depth_sigma_mm is None else 1e-3 * depth_sigma_mm)


def _run(
    verb: str,
    find: Callable[[LoggedPoses], _Found],
    path: Path,
    sensor: str | None,
    *,
    config: Path | None,
    out: Path | None,
    as_json: bool,
) -> int:
    try:
        measuring = load(EstimatorConfig, config) if config else None
        with open_log(path) as log:
            found = find(poses_of(log, sensor, measuring))
            tell_unreadable(f"rpod calibrate {verb}", log)
        file = out or found.default
        found.write(file)
    except ConfigurationError as error:
        print(f"rpod calibrate {verb}: {error}", file=sys.stderr)
        return EXIT_USAGE
    except (AnalysisError, TargetError, OSError) as error:
        print(f"rpod calibrate {verb}: {error}", file=sys.stderr)
        return EXIT_FAILURE
    if as_json:
        print(json.dumps(found.document | {"file": str(file), "findings": list(found.lines)}, indent=2))
    else:
        print("\n".join([*found.lines, f"{verb:13} {file}"]))
    return EXIT_OK
