"""``limits``: its cells, and the campaign as one object."""

from dataclasses import asdict

from rpod_campaign.engine.campaign import Campaign
from rpod_campaign.limits import trial
from rpod_campaign.limits.options import Options
from rpod_campaign.limits.report import sections, summarise, totals
from rpod_campaign.limits.trial import START, LimitsCell
from rpod_campaign.population import campaign as population
from rpod_campaign.population.options import Options as PopulationOptions


def cells(options: Options) -> list[LimitsCell]:
    """Return a cell for each satellite and world. Raises ConfigurationError, which names the option."""
    shared = options.meant(without={"scenarios", "quantile", "margin"})
    if not options.target:
        shared["population"] = "derive"
    seen = population.cells(PopulationOptions(**shared, task="tracking", scenarios=options.scenarios))
    names = list(dict.fromkeys(cell.target for cell in seen))
    after = dict(zip(names, [*names[1:], names[0]], strict=True))
    return [
        LimitsCell(
            **asdict(cell),
            other_target=after[cell.target] if len(names) > 1 else "",
            seed=options.seed,
            quantile=options.quantile,
            margin=options.margin,
        )
        for cell in seen
    ]


CAMPAIGN: Campaign[LimitsCell] = Campaign(
    name="limits",
    options=Options,
    cells=cells,
    trial=trial.run,
    schema=trial.SCHEMA,
    summarise=summarise,
    sections=sections,
    totals=totals,
    keys=(START,),
)
