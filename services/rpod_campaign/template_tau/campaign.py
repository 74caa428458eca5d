"""``template-tau``: its cells, and the campaign as one object."""

from rpod_campaign.engine.campaign import Campaign
from rpod_campaign.lidar.cells import ranges_m, targets
from rpod_campaign.template_tau import trial
from rpod_campaign.template_tau.options import Options
from rpod_campaign.template_tau.report import sections, summarise
from rpod_campaign.template_tau.trial import TAU, TauCell


def cells(options: Options) -> list[TauCell]:
    """Return the cells. Raises ConfigurationError."""
    return [
        TauCell(
            target=target,
            step_deg=step_deg,
            range_m=range_m,
            taus=tuple(sorted(set(options.taus))),
            world=world,
        )
        for target in targets(options.target)
        for step_deg in options.steps
        for range_m in ranges_m(options, target)
        for world in options.world
    ]


CAMPAIGN: Campaign[TauCell] = Campaign(
    name="template-tau",
    options=Options,
    cells=cells,
    trial=trial.run,
    schema=trial.SCHEMA,
    summarise=summarise,
    sections=sections,
    keys=(TAU,),
)
