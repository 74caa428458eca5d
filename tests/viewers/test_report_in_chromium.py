"""The report of a run in headless Chromium, which has no network."""

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest
from machine import browser
from readers import HERE

pytestmark = pytest.mark.needs("chromium")


@pytest.fixture(scope="module")
def page(summary, tmp_path_factory) -> dict[str, Any]:
    """What the page shows, and what the browser had to say."""
    picture = tmp_path_factory.mktemp("page") / "report.png"
    done = subprocess.run(
        ["node", HERE / "open_report.mjs", browser(), summary.report, picture],
        capture_output=True,
        text=True,
        timeout=120.0,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert picture.stat().st_size > 10_000
    return json.loads(done.stdout)


def test_the_browser_finds_no_fault(page):
    assert page["errors"] == []


def test_nothing_but_the_page_is_asked_for(page, summary):
    (request,) = [url for url in page["requests"] if not url.startswith(("data:", "blob:"))]
    assert request == Path(summary.report).resolve().as_uri()


def test_every_figure_is_drawn(page):
    assert len(page["figures"]) >= 3
    for figure in page["figures"]:
        assert figure["traces"]
        assert figure["marks"] > 10
        assert figure["height_px"] > 100


def test_every_image_holds_pixels(page):
    assert len(page["image_pixels"]) >= 2
    assert min(page["image_pixels"]) > 1000


def test_the_page_tells_of_this_run_and_fits_the_window(page, summary):
    for text in (summary.scenario, Path(summary.log).name, f"seed {summary.seed}"):
        assert text in page["text"]
    assert page["overflow_px"] <= 0
