"""The report of a campaign: one HTML page that opens without a network."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import plotly.io
from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from plotly.offline import get_plotlyjs

from rpod_analysis.report.figures import PLOT
from rpod_campaign.engine.report.content import Section
from rpod_campaign.engine.run import Prepared


def write_page(
    prepared: Prepared, sections: Sequence[Section], *, version: str, machine: Mapping[str, str]
) -> Path:
    """Write ``report.html`` into the campaign's folder and return its path. Raises ``OSError``."""
    loader = ChoiceLoader([PackageLoader("rpod_campaign"), PackageLoader("rpod_analysis")])  # its style sheet
    environment = Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    page = environment.get_template("campaign.html.j2").render(
        campaign=prepared.campaign,
        trials=prepared.trials,
        seed=prepared.seed,
        cells=len(prepared.cells),
        total=prepared.total,
        version=version,
        machine=machine,
        sections=[(section, [_html(figure) for figure in section.figures]) for section in sections],
        manifest=(prepared.folder.path / "manifest.json").read_text("utf-8"),
        plotly=get_plotlyjs(),
    )
    prepared.folder.report.write_text(page, encoding="utf-8")
    return prepared.folder.report


def _html(figure: Any) -> str:
    return str(plotly.io.to_html(figure, config=PLOT, full_html=False, include_plotlyjs=False))
