"""``pmd-tracking``: its cells, and the campaign as one object."""

from rpod_campaign.engine.campaign import Campaign
from rpod_campaign.engine.options import either
from rpod_campaign.papers import paper_2018 as paper
from rpod_campaign.pmd.cells import calibrated, methods, scenarios
from rpod_campaign.pmd.methods import PAPER_ICP
from rpod_campaign.pmd.options import DEPTH, FRAMES, THROUGH
from rpod_campaign.pmd.report.summary import summarise
from rpod_campaign.pmd.sequence import FRAME, SequenceCell
from rpod_campaign.pmd_tracking import trial
from rpod_campaign.pmd_tracking.options import Options
from rpod_campaign.pmd_tracking.report import sections


def cells(options: Options) -> list[SequenceCell]:
    """Return the cells. Raises ConfigurationError, which names the option."""
    return [
        SequenceCell(
            scenario=name,
            method=method,
            radius_px=radius_px,
            frames=frames,
            through=through,
            document=(calibrated(scenario) if depth == "calibrated" else scenario).model_dump_json(),
            target=scenario.target,
            model=scenario.estimator.target or "",
            case=depth,
        )
        for name, scenario in scenarios(options, ranges=options.ranges)
        for depth in either(options.depth, DEPTH)
        for frames in either(options.frames, FRAMES)
        for method, radius_px in methods(options.method, options.radius, radii_px=paper.RADII_PX)
        for through in _guesses(options, name, frames=frames, method=method)
        if options.radius or _is_asked(name, frames=frames, method=method, radius_px=radius_px)
    ]


def _is_asked(scenario: str, *, frames: str, method: str, radius_px: int | None) -> bool:
    """Return whether a radius belongs to Table 2, or is the one of all other comparisons."""
    in_table_2 = _is_papers(scenario, frames=frames, method=method)
    return radius_px in (None, paper.RADIUS_PX) or in_table_2


def _guesses(options: Options, scenario: str, *, frames: str, method: str) -> tuple[str, ...]:
    """Return the sources of first guesses; Table 2 also uses the true pose of the last image."""
    if options.through is None and _is_papers(scenario, frames=frames, method=method):
        return "tracker", "truth"
    return either(options.through or "tracker", THROUGH)


def _is_papers(scenario: str, *, frames: str, method: str) -> bool:
    """Return whether cells are the paper's, which only the documented world has."""
    return method == PAPER_ICP and frames == "keyframes" and scenario in (paper.OBLIQUE, paper.TUMBLING)


CAMPAIGN: Campaign[SequenceCell] = Campaign(
    name="pmd-tracking",
    options=Options,
    cells=cells,
    trial=trial.run,
    schema=trial.SCHEMA,
    summarise=summarise,
    sections=sections,
    keys=(FRAME,),
)
