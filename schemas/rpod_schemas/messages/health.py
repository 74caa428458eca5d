"""Messages on the services: the estimator's status, diagnostics."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from rpod_schemas.bounds import HYPOTHESES, SHARE
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages.geometry import read_pose, write_pose
from rpod_schemas.messages.header import build, read_stamp, within, write_header
from rpod_schemas.rmw.cdr import message_class
from rpod_schemas.types import Diagnostic, EstimateValidity, EstimatorStatus, Hypothesis, Integrity


def read_status(message: Any) -> EstimatorStatus:
    """Read an rpod_msgs/EstimatorStatus."""
    if len(message.hypotheses) != len(message.hypothesis_weights):
        raise MessageRejectedError(
            Reason.WRONG_SIZE,
            f"{len(message.hypotheses)} hypotheses with {len(message.hypothesis_weights)} weights",
        )
    within(HYPOTHESES, "number of hypotheses", len(message.hypotheses))
    within(SHARE, "sum of hypothesis_weights", float(np.sum(message.hypothesis_weights)))
    _not_negative(message, "cost_m2", "nis", "inlier_share", "processing_s")
    if not np.isnan(message.inlier_share):
        within(SHARE, "inlier_share", message.inlier_share)
    return build(
        EstimatorStatus,
        stamp_ns=read_stamp(message.header),
        frame_id=message.header.frame_id,
        mode=message.mode,
        source=message.source,
        sensor=message.sensor,
        accepted=message.accepted,
        reason=message.reason,
        cost_m2=message.cost_m2,
        nis=message.nis,
        inliers=message.inliers,
        inlier_share=message.inlier_share,
        processing_s=message.processing_s,
        ambiguous=message.ambiguous,
        hypotheses=_read_hypotheses(message),
        belief=getattr(message, "belief", 0),
        evidence=dict(zip(*_evidence(message), strict=True)),
    )


def _read_hypotheses(message: Any) -> tuple[Hypothesis, ...]:
    """Return the hypotheses; a status of version 1 has neither their names nor their likelihoods."""
    count = len(message.hypotheses)
    names = getattr(message, "hypothesis_names", [""] * count)
    logs = getattr(message, "hypothesis_log_likelihoods", [float("nan")] * count)
    if not len(names) == len(logs) == count:
        raise MessageRejectedError(
            Reason.WRONG_SIZE, f"{count} hypotheses with {len(names)} names and {len(logs)} log likelihoods"
        )
    rows = zip(message.hypotheses, message.hypothesis_weights, names, logs, strict=True)
    return tuple(
        build(Hypothesis, pose=read_pose(pose), weight=weight, name=name, log_likelihood=log)
        for pose, weight, name, log in rows
    )


def _evidence(message: Any) -> tuple[Sequence[str], Sequence[float]]:
    names, values = getattr(message, "evidence_names", []), getattr(message, "evidence_values", [])
    if len(names) != len(values):
        raise MessageRejectedError(
            Reason.WRONG_SIZE, f"{len(names)} names of evidence with {len(values)} values"
        )
    return names, values


def _not_negative(message: Any, *fields: str) -> None:
    for field in fields:
        if getattr(message, field) < 0.0:
            raise MessageRejectedError(
                Reason.MALFORMED,
                f"{field} is {getattr(message, field):g}, needs 0 or more, NaN where not known",
            )


def write_status(status: EstimatorStatus) -> Any:
    """Return an rpod_msgs/EstimatorStatus.

    Raises:
        MessageRejectedError: no reader would accept it; the text names the field.
    """
    message = _status_message(status)
    read_status(message)
    return message


def _status_message(status: EstimatorStatus) -> Any:
    return message_class("rpod_msgs/msg/EstimatorStatus")(
        header=write_header(status.stamp_ns, status.frame_id),
        mode=int(status.mode),
        source=int(status.source),
        sensor=status.sensor,
        accepted=status.accepted,
        reason=status.reason,
        cost_m2=status.cost_m2,
        nis=status.nis,
        inliers=status.inliers,
        inlier_share=status.inlier_share,
        processing_s=status.processing_s,
        ambiguous=status.ambiguous,
        hypotheses=[write_pose(item.pose) for item in status.hypotheses],
        hypothesis_weights=np.array([item.weight for item in status.hypotheses], np.float64),
        belief=int(status.belief),
        evidence_names=list(status.evidence),
        evidence_values=np.array(list(status.evidence.values()), np.float64),
        hypothesis_names=[item.name for item in status.hypotheses],
        hypothesis_log_likelihoods=np.array([item.log_likelihood for item in status.hypotheses], np.float64),
    )


def read_validity(message: Any) -> EstimateValidity:
    """Read an rpod_msgs/EstimateValidity."""
    return build(
        EstimateValidity,
        stamp_ns=read_stamp(message.header),
        frame_id=message.header.frame_id,
        valid=message.valid,
        age_s=message.age_s,
        reason=message.reason,
    )


def write_validity(validity: EstimateValidity) -> Any:
    """Return an rpod_msgs/EstimateValidity."""
    return message_class("rpod_msgs/msg/EstimateValidity")(
        header=write_header(validity.stamp_ns, validity.frame_id),
        valid=validity.valid,
        age_s=validity.age_s,
        reason=validity.reason,
    )


def read_integrity(message: Any) -> Integrity:
    """Read an rpod_msgs/Integrity."""
    names, values = message.evidence_names, message.evidence_values
    if len(names) != len(values):
        raise MessageRejectedError(Reason.WRONG_SIZE, f"{len(values)} values of evidence, {len(names)} names")
    fields = ("attitude_level_deg", "position_level_m", "attitude_limit_deg", "position_limit_m")
    _not_negative(message, *fields)
    return build(
        Integrity,
        stamp_ns=read_stamp(message.header),
        frame_id=message.header.frame_id,
        state=message.state,
        reason=message.reason,
        risk=message.risk,
        **{name: getattr(message, name) for name in fields},
        evidence=dict(zip(names, np.asarray(values).tolist(), strict=True)),
    )


def write_integrity(integrity: Integrity) -> Any:
    """Return an rpod_msgs/Integrity."""
    return message_class("rpod_msgs/msg/Integrity")(
        header=write_header(integrity.stamp_ns, integrity.frame_id),
        state=int(integrity.state),
        reason=integrity.reason,
        risk=integrity.risk,
        attitude_level_deg=integrity.attitude_level_deg,
        position_level_m=integrity.position_level_m,
        attitude_limit_deg=integrity.attitude_limit_deg,
        position_limit_m=integrity.position_limit_m,
        evidence_names=list(integrity.evidence),
        evidence_values=np.array(list(integrity.evidence.values()), np.float64),
    )


def read_diagnostics(message: Any) -> list[Diagnostic]:
    """Read a diagnostic_msgs/DiagnosticArray."""
    stamp_ns = read_stamp(message.header)
    return [
        build(
            Diagnostic,
            stamp_ns=stamp_ns,
            name=item.name,
            level=item.level,
            message=item.message,
            values={pair.key: pair.value for pair in item.values},
        )
        for item in message.status
    ]


def write_diagnostics(diagnostics: Sequence[Diagnostic]) -> Any:
    """Return a diagnostic_msgs/DiagnosticArray of diagnostics with the same stamp."""
    pair = message_class("diagnostic_msgs/msg/KeyValue")
    return message_class("diagnostic_msgs/msg/DiagnosticArray")(
        header=write_header(diagnostics[0].stamp_ns, ""),
        status=[
            message_class("diagnostic_msgs/msg/DiagnosticStatus")(
                level=int(item.level),
                name=item.name,
                message=item.message,
                hardware_id="",
                values=[pair(key=key, value=value) for key, value in item.values.items()],
            )
            for item in diagnostics
        ],
    )
