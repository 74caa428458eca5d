"""``lidar-acquisition``: its cells, and the campaign as one object."""

from rpod_campaign.engine.campaign import Campaign
from rpod_campaign.engine.options import either
from rpod_campaign.engine.trial.targets import model_of
from rpod_campaign.lidar.cells import methods, ranges_m, targets, variants
from rpod_campaign.lidar.options import EQ4, SAMPLING
from rpod_campaign.lidar_acquisition import trial
from rpod_campaign.lidar_acquisition.options import Options
from rpod_campaign.lidar_acquisition.report import sections, summarise
from rpod_campaign.lidar_acquisition.trial import AcquisitionCell


def cells(options: Options) -> list[AcquisitionCell]:
    """Return the cells. Raises ConfigurationError, which names the option."""
    return [
        AcquisitionCell(
            target=target,
            method=method,
            eq4=eq4,
            sampling=sampling,
            centroid=centroid,
            matcher=matcher,
            range_m=range_m,
            step_deg=step_deg,
            model=model_of(target, options.model),
            world=world,
            surroundings=surroundings,
        )
        for target in targets(options.target)
        for method in methods(options.method)
        for step_deg, centroid, matcher in variants(
            method, steps=options.steps, centroid=options.centroid, matchers=options.matcher
        )
        for eq4 in either(options.eq4, EQ4)
        for sampling in either(options.sampling, SAMPLING)
        for range_m in ranges_m(options, target)
        for world in options.world
        for surroundings in options.surroundings
    ]


CAMPAIGN: Campaign[AcquisitionCell] = Campaign(
    name="lidar-acquisition",
    options=Options,
    cells=cells,
    trial=trial.run,
    schema=trial.SCHEMA,
    summarise=summarise,
    sections=sections,
)
