from itertools import pairwise

import numpy as np
import plotly.graph_objects as go
import pytest
from synthetic_log import Frame, SyntheticRun

from rpod_analysis import open_log, read_run
from rpod_analysis.figures import _thinned, error_figure, histogram_figure, state_figure
from rpod_schemas.types import Mode


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    covariance = np.diag([1e-4, 4e-4, 9e-4, 1e-6, 4e-6, 9e-6])

    def frame(number, _time_s):
        mode = Mode.LOST if 5 <= number < 12 else Mode.TRACKING
        return Frame(mode=mode, covariance=covariance, reason="gate" if mode == Mode.LOST else "")

    path = SyntheticRun(frame=frame).write(tmp_path_factory.mktemp("figures") / "run.mcap")
    with open_log(path) as log:
        yield read_run(log)


def titles(figure):
    axes = [*figure.select_xaxes(), *figure.select_yaxes()]
    return {axis.title.text for axis in axes if axis.visible is not False and axis.title.text}


def test_every_figure_names_its_quantities_and_their_units(run):
    assert titles(error_figure(run)) == {"time [s]", "error [°]", "error [m]"}
    assert titles(state_figure(run)) == {"time [s]", "distance [m]"}
    assert {"latency [ms]", "processing [ms]"} < titles(histogram_figure(run))


def test_the_band_is_three_sigma_in_the_axes_of_its_panel(run):
    """The trace of a block of the covariance is the same in all axes."""
    bands = [trace for trace in error_figure(run).data if trace.fill == "toself"]
    assert len(bands) == 6
    sigma_deg = [np.max(trace.y) / 3.0 for trace in bands[:3]]
    sigma_m = [np.max(trace.y) / 3.0 for trace in bands[3:]]
    assert np.mean(np.square(np.deg2rad(sigma_deg))) == pytest.approx(14e-6 / 3, rel=0.1)
    assert np.sum(np.square(sigma_m)) == pytest.approx(14e-4)


def test_lines_break_where_there_were_no_estimates(run):
    line = next(trace for trace in error_figure(run).data if trace.fill is None)
    assert np.isnan(np.asarray(line.y, float)).sum() == 1


def test_the_state_bands_cover_the_run_without_overlap(run):
    bars = [trace for trace in state_figure(run).data if isinstance(trace, go.Bar)]
    spans = sorted((b, b + x) for bar in bars for b, x in zip(bar.base, bar.x, strict=True))
    assert [bar.name for bar in bars] == ["TRACKING", "LOST"]
    assert all(end == pytest.approx(start) for (_, end), (start, _) in pairwise(spans))
    assert spans[-1][1] == pytest.approx(run.seconds(run.statuses.stamp_ns)[-1])


def test_thinning_keeps_the_peaks_and_the_order():
    x = np.arange(100_000.0)
    y = np.sin(x)
    y[77_777], y[33_333] = 40.0, -50.0
    kept_x, kept_y = _thinned(x, y)
    assert kept_x.size <= 5000
    assert (np.diff(kept_x) > 0).all()
    assert (kept_y.max(), kept_y.min()) == (40.0, -50.0)


def test_a_distribution_that_is_not_known_has_no_panel(tmp_path):
    path = SyntheticRun(clock=True).write(tmp_path / "run.mcap")
    with open_log(path) as log:
        assert titles(histogram_figure(read_run(log))) == {"processing [ms]", "frames"}
