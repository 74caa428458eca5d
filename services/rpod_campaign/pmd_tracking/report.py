"""``pmd-tracking``: the 2018 paper's scenarios and its approach from 10 m to 1 m, frame to frame."""

from rpod_campaign.engine.campaign import Campaign, Options, Section
from rpod_campaign.papers import paper_2018 as paper
from rpod_campaign.pmd import sequence as trial
from rpod_campaign.pmd.cells import CALIBRATED_WIGGLING, Results, calibrated, methods, scenarios, summarise
from rpod_campaign.pmd.methods import PAPER_ICP, TRACKING
from rpod_campaign.pmd.sequence import FRAME, START_DEG, START_M, SequenceCell
from rpod_campaign.pmd.tables import LOST, by_range, errors_over_range, other_axes, overview
from rpod_campaign.pmd_tracking.beside_paper import (
    error_figures,
    pictures,
    seventh_note,
    spikes_table,
    table_2,
)

APPROACH = "approach"
_SCENARIOS = (paper.OBLIQUE, paper.TUMBLING, APPROACH)


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
            case=depth,
        )
        for name, scenario in scenarios(options, _SCENARIOS)
        for depth in options.both("depth", "raw")
        for frames in options.both("frames", "keyframes")
        for method, radius_px in methods(options, tuple(TRACKING), radii_px=paper.RADII_PX)
        for through in _guesses(options, name, frames=frames, method=method)
        if options.radius or _is_asked(name, frames=frames, method=method, radius_px=radius_px)
    ]


def _is_asked(scenario: str, *, frames: str, method: str, radius_px: int | None) -> bool:
    """Return whether a radius belongs to Table 2, or is that of all other comparisons."""
    in_table_2 = _is_papers(scenario, frames=frames, method=method)
    return radius_px in (None, paper.RADIUS_PX) or in_table_2


def _guesses(options: Options, scenario: str, *, frames: str, method: str) -> tuple[str, ...]:
    """Return where first guesses come from; Table 2 is filled from the last image's true pose as well."""
    if options.through is None and _is_papers(scenario, frames=frames, method=method):
        return "tracker", "truth"
    return options.both("through", "tracker")


def _is_papers(scenario: str, *, frames: str, method: str) -> bool:
    return method == PAPER_ICP and frames == "keyframes" and scenario != APPROACH


def sections(results: Results) -> list[Section]:
    """Return the report: what the paper shows in its order, then what it does not."""
    keyframes = [r for r in results if r.cell.frames == "keyframes" and r.cell.case == results[0].cell.case]
    full = [result for result in results if result.cell.frames == "full"]
    usual = [result for result in results if result.cell.radius_px in (None, paper.RADIUS_PX)]
    return [
        Section(
            "RMS and time of ICP with reverse calibration (Table 2)",
            "Ours / printed. Attitude is Log(R_truth^T R_estimate) in target axes, position in camera axes; "
            "the paper does not state its own, so the other choice stands below. Frame to frame, one failure "
            "makes the next, so the technique is tried from the last image's true pose as well. The paper's "
            "times are of C++ on a processor that it does not name.",
            table_2(keyframes),
        ),
        Section(
            "Error of every image (Figs. 10 to 12)",
            f"ICP's radius is {paper.RADIUS_PX} px. Diamonds are what Tables 3 and 4 print; the paper's "
            "curves are not in its text.",
            figures=error_figures(keyframes),
        ),
        Section(
            "The images where the paper's EPnP beats its ICP (Tables 3 and 4)",
            "Norms of the errors of single images, ours / printed: another target's pictures in another "
            "light, so that what compares is whether the techniques fail on different images.",
            spikes_table(keyframes),
        ),
        Section("The seventh images (Figs. 13 and 14)", seventh_note(), figures=pictures(keyframes)),
        Section(
            "All methods",
            f"Raw depth has all of the camera's wiggling, calibrated depth {CALIBRATED_WIGGLING:g} of it. "
            f"The first frame's guess is {START_DEG:g} deg and {1e2 * START_M:g} cm off in a random "
            f"direction. {LOST}",
            (*overview(usual), other_axes(usual)),
        ),
        *(
            [Section("Over the range", "", (by_range(full),), errors_over_range(full))]
            if full
            else [Section("Over the range", "", (by_range(usual),))]
        ),
    ]


CAMPAIGN: Campaign[SequenceCell] = Campaign(
    name="pmd-tracking",
    title="Tracking in the images of a PMD camera",
    trials=1,
    accepts=frozenset({"scenario", "method", "radius", "frames", "through", "depth"}),
    cells=cells,
    trial=trial.run,
    schema=trial.SCHEMA,
    summarise=summarise,
    sections=sections,
    keys=(FRAME,),
)
