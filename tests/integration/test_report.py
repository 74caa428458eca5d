"""The report of a whole run, with images and wireframe of a shipped target."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from synthetic_log import TINY_CAMERA, Frame, SyntheticRun, see_depth, see_points

from rpod_analysis.report import group_parts, unique_names, write_comparison, write_report
from rpod_schemas.summary import Comparison, Summary
from rpod_schemas.types import Camera, Mode
from rpod_target import load_target

CAMERA = Camera(width=88, height=72, fx=90.0, fy=90.0, cx=43.5, cy=35.5)


def frame(number, _time_s):
    if number < 2:
        return Frame(mode=Mode.ACQUIRING, reason="not believed: cost 0.31 m2")
    return Frame(attitude_rad=(0.01, 0.0, 0.0), position_m=(0.0, 0.01, 0.0), covariance=np.eye(6) * 1e-4)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    directory = tmp_path_factory.mktemp("report")
    run = SyntheticRun(
        camera=CAMERA,
        target="mockup",
        render=see_depth(load_target("mockup"), CAMERA),
        frame=frame,
        unlogged=1,
    )
    return write_report([run.write(directory / "run.mcap")])


@pytest.fixture(scope="module")
def page(written):
    return written.html.read_text("utf-8")


@pytest.fixture(scope="module")
def body(page):
    """The page without plotly's own code."""
    return page[: page.index("<script>")] + page[page.index("</script>", page.index("<script>")) :]


def test_report_and_summary_stand_beside_the_log(written):
    assert {file.name for file in written.html.parent.iterdir()} == {
        "run.mcap",
        "report.html",
        "summary.json",
        "truth.parquet",
        "frames.parquet",
        "truth.tum",
        "estimate.tum",
    }
    summary = Summary.model_validate_json(written.summary.read_text("utf-8"))
    assert summary.report == str(written.html)
    assert summary.log == str(written.html.parent / "run.mcap")


def test_the_page_loads_nothing_from_anywhere(page, body):
    assert not re.search(r"https?://", body.replace("http://www.w3.org/2000/svg", ""))
    loads = re.findall(r"<(?:link|script|img|iframe|object|embed)\b[^>]*>", body)
    assert not [tag for tag in loads if re.search(r"\b(src|href|data)\s*=", tag)]
    assert "@import" not in body
    assert "url(" not in body
    for uri in re.findall(r'href="([^"#][^"]*)"', body):
        assert uri.startswith("data:image/")
    assert page.count("<!doctype html>") == 1


def test_the_page_is_small_enough_to_be_mailed(written):
    assert written.html.stat().st_size < 6_000_000


def test_the_page_says_what_was_run_and_how_it_went(body):
    for text in ("synthetic-approach", "mockup", "rpod 0.1.0", "run.mcap"):
        assert text in body
    assert "The run has findings: log, completeness." in body
    assert re.search(r"<td>pmd/depth/image_raw</td><td[^>]*>21</td><td[^>]*>20</td><td[^>]*>1</td>", body)
    assert "not believed: cost … m2" in body


def test_every_section_and_every_figure_has_an_id_of_its_own(page, body):
    figures = ("state", "errors", "consistency", "timing", "path")
    assert page.count("Plotly.newPlot(") == len(figures) + get_own_mentions(page)
    for name in figures:
        assert body.count(f'id="figure-{name}"') == 1
    for name in ("outcome", *figures, "snapshots", "frames", "completeness", "configuration"):
        assert body.count(f'id="{name}"') == 1


def test_every_frame_of_a_sensor_is_accounted_for(body):
    row = re.search(r"<tr><td>pmd</td>(.*?)</tr>", body).group(1)
    published, accepted, rejected, passed_over, incomplete, rest = map(int, re.findall(r">(\d+)<", row))
    assert (published, accepted, rejected) == (21, 19, 2)
    assert published == accepted + rejected + passed_over + incomplete + rest


def test_the_page_tells_what_the_log_says_of_its_completeness(body):
    section = body[body.index('id="completeness"') :]
    assert "No." in section
    assert "<li>/pmd/depth/image_raw: 1 missed on the bus</li>" in section


def get_own_mentions(page):
    """How often plotly's own code names the function."""
    start = page.index("<script>")
    return page[start : page.index("</script>", start)].count("Plotly.newPlot(")


def test_depth_and_amplitude_are_shown_with_the_wireframe_at_estimate_and_truth(body):
    assert body.count("data:image/webp;base64,") == 8
    paths = dict(re.findall(r'id="shot-\d-([et])" d="([^"]*)"', body))
    assert len(paths["e"]) > 300
    assert len(paths["t"]) > 300
    assert paths["e"] != paths["t"]


def test_the_wireframe_lies_on_the_surface_that_the_camera_saw(body):
    """The truth's outline and the depth image bound the same part of the picture."""
    views = [tuple(map(float, view.split())) for view in re.findall(r'viewBox="([^"]+)"', body)]
    truths = re.findall(r'id="shot-\d-t" d="([^"]*)"', body)
    target = load_target("mockup")
    for index, path in enumerate(truths):
        points = np.array([pair.split() for pair in re.findall(r"[-\d.]+ [-\d.]+", path)], float)
        left, top, width, height = views[2 * index]
        assert (points >= (left, top)).all()
        assert (points <= (left + width, top + height)).all()
        assert np.ptp(points, axis=0).max() * 5.0 / CAMERA.fx < 2.2 * target.radius_m


def test_what_was_not_used_is_told_and_the_pixels_of_a_refused_frame_are_shown(tmp_path):
    marked = np.zeros((6, 8), np.bool_)
    marked[2, 5] = True
    refused = Frame(mode=Mode.LOST, reason="a detail contradicts the pose", marked=marked)
    run = SyntheticRun(duration_s=1.0, frame=lambda number, _: refused if number == 4 else Frame(), late=3)
    page = write_report([run.write(tmp_path / "run.mcap")]).html.read_text("utf-8")
    section = page[page.index('id="refused"') :]
    side = TINY_CAMERA.width / 8
    assert section.count(f'class="marks" d="M{5 * side - 0.5:.1f} {2 * side - 0.5:.1f}h{side:.1f}') == 2
    assert "a detail contradicts the pose" in section
    inputs = page[page.index('id="inputs"') :]
    assert 'not used: late</td><td class="n">3</td><td>late: 1.250 s old' in inputs


def test_a_lidars_returns_are_drawn(tmp_path):
    run = SyntheticRun(
        kind="lidar",
        name="lidar",
        rate_hz=2.0,
        target="mockup",
        render=see_points(load_target("mockup")),
        frame=frame,
    )
    page = write_report([run.write(tmp_path / "run.mcap")]).html.read_text("utf-8")
    assert 'class="lines dots"' in page
    assert re.search(r'id="shot-1-e" d="M', page)


def test_a_run_without_target_truth_or_estimates_still_has_a_page(tmp_path):
    run = SyntheticRun(with_truth=False, frame=lambda *_: Frame(mode=Mode.ACQUIRING, reason="nothing found"))
    page = write_report([run.write(tmp_path / "run.mcap")], tmp_path / "elsewhere").html.read_text("utf-8")
    assert "The target was not acquired." in page
    assert "nothing is scored" in page
    assert "errors as if the target had no symmetry: no configuration in the log names the target." in page
    assert json.loads((tmp_path / "elsewhere" / "summary.json").read_text("utf-8"))["error"] is None


def test_text_from_the_log_is_escaped(tmp_path):
    run = SyntheticRun(frame=lambda *_: Frame(reason="<img src=x onerror=alert(1)>"))
    page = write_report([run.write(tmp_path / "run.mcap")]).html.read_text("utf-8")
    assert "<img src=x" not in page


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    folder = tmp_path_factory.mktemp("compared")
    good, poor = folder / "good" / "run.mcap", folder / "poor" / "run.mcap"
    for path, shift_m in ((good, 0.01), (poor, 0.05)):
        path.parent.mkdir()
        SyntheticRun(frame=lambda *_, shift_m=shift_m: Frame(position_m=(0.0, shift_m, 0.0))).write(path)
    return write_comparison([[good], [poor]])


def test_several_runs_of_one_folder_have_folders_of_their_own(tmp_path):
    runs = [[SyntheticRun(frame=frame).write(tmp_path / f"{name}.mcap")] for name in ("first", "second")]
    compared = write_comparison(runs)
    assert compared.html.parent == tmp_path
    for name in ("first", "second"):
        summary = Summary.model_validate_json((tmp_path / name / "summary.json").read_text("utf-8"))
        assert Path(summary.log).stem == name
    assert not (tmp_path / "report.html").exists()


def test_several_runs_stand_side_by_side_in_one_page_and_have_reports_of_their_own(compared):
    folder = compared.html.parent
    for name in ("good", "poor"):
        assert (folder / name / "report.html").exists()
        assert (folder / name / "frames.parquet").exists()
    page = compared.html.read_text("utf-8")
    row = re.search(r"<td>position error, rms</td>(.*?)</tr>", page).group(1)
    assert re.findall(r"[\d.]+(?=</)|(?<=<b>)[\d.]+", row) == ["10", "50"]
    assert "<b>10</b>" in row
    for identity in ("figure-comparison", "log-1", "log-2", "log-1-figure-errors", "log-2-completeness"):
        assert page.count(f'id="{identity}"') == 1
    assert len(set(re.findall(r'\bid="([^"]+)"', page))) == len(re.findall(r'\bid="([^"]+)"', page))


def test_the_comparisons_json_is_the_summaries_in_the_given_order(compared):
    comparison = Comparison.model_validate_json(compared.summary.read_bytes())
    assert [round(run.error.position_m.rms, 6) for run in comparison.runs] == [0.01, 0.05]
    assert comparison.report == str(compared.html)


def test_parts_of_a_run_are_one_and_other_names_and_folders_are_other_runs():
    paths = [Path(name) for name in ("a/x.mcap", "a/x_0002.mcap", "b/x.mcap", "a/y.recovered.mcap", "folder")]
    assert group_parts(paths) == [paths[:2], [paths[2]], [paths[3]], [paths[4]]]
    assert unique_names([paths[0], paths[3]]) == ["x", "y.recovered"]
    assert unique_names([paths[0], paths[2]]) == ["a", "b"]
    assert unique_names([paths[0], paths[0]]) == ["a-1", "a-2"]


def test_the_rays_of_a_refused_scan_are_marked(tmp_path):
    marked = np.zeros((40, 40), np.bool_)
    marked[18:22, 20] = True
    refused = Frame(mode=Mode.LOST, reason="does not explain the scan", marked=marked)
    run = SyntheticRun(
        kind="lidar",
        name="lidar",
        rate_hz=2.0,
        target="mockup",
        render=see_points(load_target("mockup")),
        frame=lambda number, _: refused if number == 2 else Frame(),
    )
    page = write_report([run.write(tmp_path / "run.mcap")]).html.read_text("utf-8")
    section = page[page.index('id="refused"') :]
    assert "lidar: does not explain the scan" in section
    (squares,) = re.findall(r'class="marks" d="([^"]+)"', section)
    found = np.array(
        [list(map(float, each)) for each in re.findall(r"M([-\d.]+) ([-\d.]+)h([\d.]+)", squares)]
    )
    angles = np.radians(np.linspace(-10.0, 10.0, 40))
    expected = [(np.tan(angles[20]), np.tan(angles[row]) / np.cos(angles[20])) for row in range(18, 22)]
    np.testing.assert_allclose(found[:, :2] + found[:, 2:] / 2.0, 1e3 * np.array(expected), atol=0.1)
