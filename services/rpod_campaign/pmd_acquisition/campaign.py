"""``pmd-acquisition``: its cells, and the campaign as one object."""

from rpod_campaign.engine.campaign import Campaign
from rpod_campaign.pmd.cells import chosen, methods, ranges_m, scenarios
from rpod_campaign.pmd_acquisition import trial
from rpod_campaign.pmd_acquisition.options import Options
from rpod_campaign.pmd_acquisition.report import sections, summarise
from rpod_campaign.pmd_acquisition.trial import AcquisitionCell

CASES = {
    "front": ("front", "none"),
    "all": ("all", "none"),
    "front-wide": ("front", "wide"),
    "all-wide": ("all", "wide"),
}
"""View and start by the case's name on the command line."""


def cells(options: Options) -> list[AcquisitionCell]:
    """Return the cells. Raises ConfigurationError, which names the option."""
    return [
        AcquisitionCell(
            view=view,
            start=start,
            method=method,
            range_m=ranges_m(chosen(options, scenario), scenario),
            document=scenario.model_dump_json(),
            target=scenario.target,
            model=scenario.estimator.target or "",
            world=scenario.world,
            surroundings=name,
        )
        for name in options.surroundings
        for _, scenario in scenarios(options.model_copy(update={"surroundings": (name,)}))
        for method, _ in methods(options.method)
        for view, start in (CASES[case] for case in options.case)
    ]


CAMPAIGN: Campaign[AcquisitionCell] = Campaign(
    name="pmd-acquisition",
    options=Options,
    cells=cells,
    trial=trial.run,
    schema=trial.SCHEMA,
    summarise=summarise,
    sections=sections,
)
