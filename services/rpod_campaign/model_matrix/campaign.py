"""``model-matrix``: its cells, and the campaign as one object."""

from dataclasses import replace

from rpod_campaign.engine.campaign import Campaign
from rpod_campaign.engine.trial.targets import model_of
from rpod_campaign.model_matrix import trial
from rpod_campaign.model_matrix.options import Options
from rpod_campaign.model_matrix.report import sections
from rpod_campaign.model_matrix.trial import PopulationCell
from rpod_campaign.population import campaign as population
from rpod_campaign.population.options import Options as PopulationOptions
from rpod_campaign.population.report import summarise


def cells(options: Options) -> list[PopulationCell]:
    """Return the cells of each target with itself and with each model. Raises ConfigurationError."""
    shared = options.meant(without={"models", "scenarios"})
    seen = population.cells(PopulationOptions(**shared, scenarios=options.scenarios))
    return [
        replace(cell, task=task, model=model_of(cell.target, model))
        for cell in seen
        for model in (None, *options.models)
        for task in ("acquisition", "tracking")
    ]


CAMPAIGN: Campaign[PopulationCell] = Campaign(
    name="model-matrix",
    options=Options,
    cells=cells,
    trial=trial.run,
    schema=trial.SCHEMA,
    summarise=summarise,
    sections=sections,
)
