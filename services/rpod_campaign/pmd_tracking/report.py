"""``pmd-tracking``: the 2018 paper's scenarios and its approach from 10 m to 1 m, frame to frame."""

from rpod_campaign.engine.report.content import Section
from rpod_campaign.papers import paper_2018 as paper
from rpod_campaign.pmd.cells import CALIBRATED_WIGGLING
from rpod_campaign.pmd.report.summary import Results
from rpod_campaign.pmd.report.tables import LOST, by_range, errors_over_range, other_axes, overview
from rpod_campaign.pmd.sequence import START_DEG, START_M
from rpod_campaign.pmd_tracking.beside_paper import (
    error_figures,
    pictures,
    pictures_caption,
    spikes_table,
    table_2,
)


def sections(results: Results) -> list[Section]:
    """Return the sections of the report for the methods that were run.

    Those of the paper come first, in its order.
    """
    return [section for section in _sections(results) if section.tables or section.figures]


def _sections(results: Results) -> list[Section]:
    keyframes = [r for r in results if r.cell.frames == "keyframes" and r.cell.case == results[0].cell.case]
    full = [result for result in results if result.cell.frames == "full"]
    usual = [result for result in results if result.cell.radius_px in (None, paper.RADIUS_PX)]
    return [
        Section(
            "RMS and time of ICP with reverse calibration (Table 2)",
            "Measured here / printed. Attitude is Log(R_truth^T R_estimate) in target axes, position in "
            "camera axes; the paper does not state its own, so that the other choice follows below. "
            "Frame to frame, one failure causes the next; therefore the technique also starts from the last "
            "image's true pose. "
            "The paper's times are from C++ on a processor that it does not name.",
            table_2(keyframes),
        ),
        Section(
            "Error of every image (Figs. 10 to 12)",
            f"ICP's radius is {paper.RADIUS_PX} px. Diamonds are the values of Tables 3 and 4; the paper's "
            "curves are not in its text.",
            figures=error_figures(keyframes),
        ),
        Section(
            "The images on which the paper's EPnP is better than its ICP (Tables 3 and 4)",
            "Norms of the errors of single images, measured here / printed. The paper's images show another "
            "target in another light, so that only one thing is comparable: whether the techniques fail on "
            "different images.",
            spikes_table(keyframes),
        ),
        Section("The seventh images (Figs. 13 and 14)", pictures_caption(), figures=pictures(keyframes)),
        Section(
            "All methods",
            f"Raw depth has all of the camera's wiggling, calibrated depth {CALIBRATED_WIGGLING:g} of it. "
            f"The first frame's guess has an error of {START_DEG:g} deg and {1e2 * START_M:g} cm in random "
            f"directions. {LOST}",
            (*overview(usual), other_axes(usual)),
        ),
        *(
            [Section("Over the range", "", (by_range(full),), errors_over_range(full))]
            if full
            else [Section("Over the range", "", (by_range(usual),))]
        ),
    ]
