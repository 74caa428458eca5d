"""The matrix: which faults of the catalogue are tried, with which sizes and for how long."""

from dataclasses import dataclass

from rpod_schemas.faults import BY_NAME


@dataclass(frozen=True)
class Row:
    """A fault with its sweep; one without sizes is swept over its durations."""

    fault: str
    sizes: tuple[float, ...] = ()
    durations_s: tuple[float, ...] = (2.0,)

    @property
    def cells(self) -> tuple[tuple[float | None, float], ...]:
        """Sizes with durations, s."""
        return tuple((size, lasts_s) for size in self.sizes or (None,) for lasts_s in self.durations_s)


ROWS = (
    Row("glints", (0.2, 0.4, 0.8)),
    Row("dropout", (0.3, 0.6, 0.9)),
    Row("partial", (0.4, 0.8)),
    Row("biased", (0.02, 0.15, 0.5)),
    Row("clock_behind", (0.05, 0.2)),
    Row("clock_ahead", (0.05, 0.2)),
    Row("lost_frames", (0.125, 0.5)),
    Row("mirrored"),
    Row("saturation"),
    Row("blackout", durations_s=(0.5, 2.0)),
    Row("frozen", durations_s=(0.5, 2.0)),
    Row("silence", durations_s=(0.5, 2.0)),
    Row("stop", durations_s=(0.5, 2.0)),
    Row("kill", durations_s=(2.0,)),
    Row("link_delay", (0.05, 0.2, 1.0)),
    Row("link_loss", (0.01, 0.05)),
    Row("link_rate", (10.0, 30.0)),
    Row("link_stall", durations_s=(0.5, 2.0)),
    Row("link_half_open", durations_s=(0.5, 2.0)),
    Row("link_cut", durations_s=(0.5, 2.0)),
)
"""Faults that can be tried in one process. Of links, only what follows for the frames is tried."""
BY_FAULT = {row.fault: row for row in ROWS}
DEFAULTS = ("glints", "biased", "clock_behind", "blackout", "frozen", "silence", "stop", "kill", "link_stall")


def can_have(sensor: str, fault: str) -> bool:
    """Return whether a sensor, its link, or the estimator behind it, can have a fault."""
    kind = BY_NAME[fault]
    return kind.subject in {"process", "link"} or sensor in kind.kinds
