"""``population``: its cells, and the campaign as one object."""

from rpod_campaign.engine.campaign import Campaign
from rpod_campaign.engine.trial.targets import model_of
from rpod_campaign.lidar.cells import targets
from rpod_campaign.pmd.cells import scenarios
from rpod_campaign.pmd.options import PmdOptions
from rpod_campaign.population import trial
from rpod_campaign.population.options import Options
from rpod_campaign.population.report import sections, summarise, totals
from rpod_campaign.population.trial import PopulationCell
from rpod_target.population.names import name_of


def cells(options: Options) -> list[PopulationCell]:
    """Return a cell for each satellite, world and surroundings. Raises ConfigurationError."""
    camera = options.sensor == "pmd"
    names = targets(options.target) or tuple(
        name_of(options.population, options.seed, index, small=camera) for index in range(options.bodies)
    )
    wanted = options.filled if camera else options.returns
    return [
        PopulationCell(
            target=name,
            sensor=options.sensor,
            task=options.task,
            wanted=wanted,
            model=model_of(name, options.model),
            world=world,
            document=document,
            surroundings=surroundings,
        )
        for name in names
        for world, document in zip(options.world, _documents(options), strict=True)
        for surroundings in options.surroundings
    ]


def _documents(options: Options) -> tuple[str, ...]:
    """Return the JSON of the scenario in each world; empty for a LIDAR."""
    if options.sensor == "lidar":
        return ("",) * len(options.world)
    shared = PmdOptions(
        scenario=(options.scenario,), world=options.world, scenarios=options.scenarios, seed=options.seed
    )
    return tuple(scenario.model_dump_json() for _, scenario in scenarios(shared))


CAMPAIGN: Campaign[PopulationCell] = Campaign(
    name="population",
    options=Options,
    cells=cells,
    trial=trial.run,
    schema=trial.SCHEMA,
    summarise=summarise,
    sections=sections,
    totals=totals,
)
