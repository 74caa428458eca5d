"""``lidar-trajectory``: 241 positions along a safety ellipse (2015 paper, section 4.4)."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import polars as pl

from rpod_campaign.engine.campaign import CellResult
from rpod_campaign.engine.report.content import Section
from rpod_campaign.engine.report.statistics import mean, quantile, rate_of
from rpod_campaign.lidar_trajectory import trial
from rpod_campaign.lidar_trajectory.figures import figures_over_steps, figures_over_time
from rpod_campaign.lidar_trajectory.tables import (
    attitude_table,
    cost_table,
    fast_table,
    position_table,
    success_table,
)
from rpod_campaign.lidar_trajectory.trial import INTERVAL_S, MATCHERS, POSITIONS, TrajectoryCell
from rpod_campaign.papers import paper_2015 as paper

Results = Sequence[CellResult[TrajectoryCell]]
_TUMBLE = ", ".join(f"{rate:g}" for rate in trial.TUMBLE_DEG_S)


def summarise(cell: TrajectoryCell, rows: pl.DataFrame) -> dict[str, Any]:
    """Return the summary of a cell."""
    summary: dict[str, Any] = {
        **asdict(cell),
        "trials": rows.height,
        "templates": rows["templates"].max(),
        "excluded_share": mean(rows["excluded_share"]),
        "median_s": quantile(rows["search_s"], 0.5),
        "p95_s": quantile(rows["search_s"], 0.95),
    }
    for icp, matcher in MATCHERS.items():
        share = rate_of(rows, f"{icp}_success")
        name = matcher.replace("-", "_")
        summary |= {
            f"{name}_success_rate": share.value,
            f"{name}_wilson_low": share.low,
            f"{name}_wilson_high": share.high,
        }
    return summary


def sections(results: Results) -> list[Section]:
    """Return the sections of the report."""
    return [
        Section(
            "Along the trajectory (Fig. 5)",
            f"{POSITIONS} positions {INTERVAL_S:g} s apart on a safety ellipse of 25 to 53 m about the "
            "target's centre of mass, with the secular effects of J2. Assumed, because the paper does not "
            f"state it: the target tumbles without torque, with {_TUMBLE} deg/s about its axes at first; the "
            "sensor points at its centre of mass, and the range is measured to this point.",
            figures=figures_over_time(results),
        ),
        Section(
            "Template matching over the step (Fig. 6)",
            "Success: attitude within 3 deg after ICP, with the two ways to pair points; 95 % Wilson "
            "intervals. The paper's times are from MATLAB on a 3.4 GHz i7. It states the success at 30 deg "
            "three times: in sections 4.4 and 4.5 and in its conclusions.",
            (success_table(results),),
            figures_over_steps(results),
        ),
        Section(
            "The fast variant (Fig. 7)",
            "Success lost, templates left out and time saved against template matching in the same cell.",
            (fast_table(results),),
        ),
        Section(
            "Attitude of the template (Table 2)",
            "Averages over the successes (nearest neighbour). The paper does not define its differences of "
            "Euler angles. Raw is the absolute difference, wrapped the same modulo 360 deg, geodesic the "
            "angle of the rotation between the two attitudes. At a pitch of 90 deg, where roll and yaw are "
            "the same rotation, the roll is set to zero.",
            (attitude_table(results),),
        ),
        Section(
            "Position of the template (Table 3)",
            "Averages of the absolute errors along the sensor's axes, over successes and failures (nearest "
            "neighbour).",
            (position_table(results),),
        ),
        Section(
            "f_CONV (Fig. 9, Table 4)",
            "Mean squared distance of all points from the surface after ICP (nearest neighbour), in m2. In "
            f"prose the paper states: {paper.COSTS_IN_PROSE}.",
            (cost_table(results),),
        ),
    ]
