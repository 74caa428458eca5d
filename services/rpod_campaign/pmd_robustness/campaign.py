"""``pmd-robustness``: its cells, and the campaign as one object."""

from typing import Any

from rpod_campaign.engine.campaign import Campaign
from rpod_campaign.engine.options import either
from rpod_campaign.pmd.cells import calibrated, methods, scenarios
from rpod_campaign.pmd.options import FRAMES, THROUGH
from rpod_campaign.pmd.report.summary import summarise
from rpod_campaign.pmd.sequence import FRAME, SequenceCell
from rpod_campaign.pmd_robustness import trial
from rpod_campaign.pmd_robustness.options import Options
from rpod_campaign.pmd_robustness.report import sections
from rpod_campaign.pmd_robustness.trial import CASES
from rpod_schemas.config.base import check
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
            document=approaching(calibrated(scenario), CASES[name].range_m).model_dump_json(),
            target=scenario.target,
            case=name,
            world=CASES[name].world,
        )
        for scenario_name, scenario in scenarios(options)
        for frames in either(options.frames, FRAMES)
        for through in either(options.through, THROUGH)
        for method, radius_px in methods(options.method, options.radius)
        for name in options.case
    ]


def approaching(scenario: Scenario, range_m: tuple[float, float]) -> Scenario:
    """Return a scenario with a straight approach from one range to another, m."""
    document: dict[str, Any] = scenario.model_dump(mode="json")
    start_m, end_m = range_m
    document["motion"]["trajectory"] |= {"start_m": [0.0, 0.0, start_m], "end_m": [0.0, 0.0, end_m]}
    return check(Scenario, document, source=scenario.name)


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
