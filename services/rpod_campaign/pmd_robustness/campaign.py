"""``pmd-robustness``: its cells, and the campaign as one object."""

from rpod_campaign.engine.campaign import Campaign
from rpod_campaign.engine.options import either
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.pmd.cells import approaching, calibrated, methods, ranges_m, scenarios
from rpod_campaign.pmd.options import FRAMES, THROUGH
from rpod_campaign.pmd.poses import in_proportion
from rpod_campaign.pmd.report.summary import summarise
from rpod_campaign.pmd.sequence import FRAME, SequenceCell
from rpod_campaign.pmd_robustness import trial
from rpod_campaign.pmd_robustness.options import Options
from rpod_campaign.pmd_robustness.report import sections
from rpod_campaign.pmd_robustness.trial import CASES, START_M, Case
from rpod_schemas.config.scenario import Scenario


def cells(options: Options) -> list[SequenceCell]:
    """Return the cells. Raises ConfigurationError, which names the option."""
    return [
        SequenceCell(
            scenario=scenario_name,
            method=method,
            radius_px=radius_px,
            frames=frames,
            through=through,
            document=approaching(
                calibrated(scenario), case_ranges_m(scenario, CASES[name])
            ).model_dump_json(),
            target=scenario.target,
            model=scenario.estimator.target or "",
            case=name,
            world=CASES[name].world,
        )
        for scenario_name, scenario in scenarios(options)
        for frames in either(options.frames, FRAMES)
        for through in either(options.through, THROUGH)
        for method, radius_px in methods(options.method, options.radius)
        for name in options.case
    ]


def case_ranges_m(scenario: Scenario, case: Case) -> tuple[float, float]:
    """Return the ranges of a case at the start and the end, m; in proportion to another target's size."""
    target = cached_target(scenario.target)
    reach = ranges_m(None, scenario)[1] / START_M
    scale = min(in_proportion(1.0, target), max(1.0, reach))
    start_m, end_m = case.range_m
    return scale * start_m, scale * end_m


CAMPAIGN: Campaign[SequenceCell] = Campaign(
    name="pmd-robustness",
    options=Options,
    cells=cells,
    trial=trial.run,
    schema=trial.SCHEMA,
    summarise=summarise,
    sections=sections,
    keys=(FRAME,),
)
