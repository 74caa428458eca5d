from itertools import pairwise

import numpy as np
import plotly.graph_objects as go
import pytest
from synthetic_log import Frame, SyntheticRun

from rpod_analysis import open_log, stream_run
from rpod_analysis.report.downsampling import Line
from rpod_analysis.report.figures import error_figure, state_figure
from rpod_analysis.report.figures_path import path_figure
from rpod_analysis.report.figures_statistics import consistency_figure, timing_figure
from rpod_analysis.report.plot_data import PlotData
from rpod_analysis.scoring.totals import RunTotals
from rpod_schemas.types import Mode


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    covariance = np.diag([1e-4, 4e-4, 9e-4, 1e-6, 4e-6, 9e-6])

    def frame(number, _time_s):
        mode = Mode.LOST if 5 <= number < 12 else Mode.TRACKING
        reason = "gate" if mode == Mode.LOST else ""
        return Frame(mode=mode, covariance=covariance, reason=reason, nis=4.0, position_m=(0.01, 0.0, 0.0))

    path = SyntheticRun(frame=frame).write(tmp_path_factory.mktemp("figures") / "run.mcap")
    with open_log(path) as log:
        yield stream_run(log)


@pytest.fixture(scope="module")
def digest(run):
    return PlotData.of(run)


@pytest.fixture(scope="module")
def totals(run):
    return RunTotals.of(*run)


def titles(figure):
    axes = [*figure.select_xaxes(), *figure.select_yaxes()]
    return {axis.title.text for axis in axes if axis.visible is not False and axis.title.text}


def test_every_figure_names_its_quantities_and_their_units(digest, totals):
    assert titles(error_figure(digest)) == {"time [s]", "error [°]", "error [m]"}
    assert titles(state_figure(digest)) == {"time [s]", "distance [m]", "state", "source"}
    assert titles(timing_figure(totals)) == {"latency [ms]", "processing [ms]", "frames"}
    assert titles(consistency_figure(digest, totals)) == {
        "time [s]", "NEES [-]", "NIS [-]", "share of frames per bin",
    }  # fmt: skip
    path = path_figure(digest)
    assert titles(path) == {"x [m]", "y [m]", "z [m]"}
    assert path.layout.scene.zaxis.title.text == "z [m]"


def test_the_band_is_three_sigma_in_the_axes_of_its_panel(digest):
    """The trace of a block of the covariance is the same in all axes."""
    bands = [trace for trace in error_figure(digest).data if trace.fill == "toself"]
    assert len(bands) == 6
    sigma_deg = [np.nanmax(trace.y) / 3.0 for trace in bands[:3]]
    sigma_m = [np.nanmax(trace.y) / 3.0 for trace in bands[3:]]
    assert np.mean(np.square(np.deg2rad(sigma_deg))) == pytest.approx(14e-6 / 3, rel=0.1)
    assert np.sum(np.square(sigma_m)) == pytest.approx(14e-4)


def test_lines_break_where_there_were_no_estimates(digest):
    drawn = error_figure(digest).data
    line = next(trace for trace in drawn if trace.fill is None)
    assert np.isnan(np.asarray(line.y, float)).sum() == 1
    band = next(trace for trace in drawn if trace.fill == "toself")
    assert np.isnan(np.asarray(band.y, float)).sum() == 2, "two polygons"


def test_the_state_bands_cover_the_run_without_overlap(run, digest):
    bars = [trace for trace in state_figure(digest).data if isinstance(trace, go.Bar) and trace.xaxis == "x"]
    spans = sorted((b, b + x) for bar in bars for b, x in zip(bar.base, bar.x, strict=True))
    assert [bar.name for bar in bars] == ["TRACKING", "LOST"]
    assert all(end == pytest.approx(start) for (_, end), (start, _) in pairwise(spans))
    assert spans[-1][1] == pytest.approx(run.whole().seconds(run.whole().statuses.stamp_ns)[-1])


def test_bounds_of_nees_and_nis_are_drawn_and_the_expected_shares_are_chi_squareds(digest, totals):
    figure = consistency_figure(digest, totals)
    levels = sorted({shape.y0 for shape in figure.layout.shapes})
    assert levels == [6.0, 12.59]
    found, expected = (trace for trace in figure.data if trace.xaxis == "x2")
    assert sum(found.x) == pytest.approx(1.0)
    within = [share for share, nees in zip(expected.x, expected.y, strict=True) if nees < 12.59]
    assert sum(within) == pytest.approx(0.95, abs=0.015)  # the bound lies within a bin


def test_the_names_of_the_bounds_stand_above_the_panels_and_cover_no_point(digest, totals):
    texts = consistency_figure(digest, totals).layout.annotations
    bounds = "95 % bound 12.59 (red), expected mean 6 (grey)"
    assert [each.text for each in texts] == [
        f"NEES of the tracked frames: {bounds}",
        "distribution",
        f"NIS of the measurements: {bounds}",
        "distribution",
    ]
    assert all(each.yref == "paper" and each.yanchor == "bottom" for each in texts)


def test_thinning_keeps_the_peaks_and_the_order():
    stamp_ns = np.arange(100_000) * 1_000_000
    values = np.sin(stamp_ns * 1e-6)
    values[77_777], values[33_333] = 40.0, -50.0
    line = Line((0, 99_999_000_000))
    for part in np.array_split(np.arange(100_000), 23):
        line.extend(stamp_ns[part], values[part])
    assert line.stamp_ns.size <= 5200
    assert (np.diff(line.stamp_ns) > 0).all()
    assert (line.values.max(), line.values.min()) == (40.0, -50.0)


def test_a_distribution_that_is_not_known_has_no_panel(tmp_path):
    path = SyntheticRun(clock=True).write(tmp_path / "run.mcap")
    with open_log(path) as log:
        run = stream_run(log)
    assert titles(timing_figure(RunTotals.of(*run))) == {"processing [ms]", "frames"}
    assert consistency_figure(PlotData.of(run), RunTotals.of(*run)) is None
