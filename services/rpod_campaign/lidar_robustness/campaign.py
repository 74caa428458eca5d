"""``lidar-robustness``: its cells, and the campaign as one object."""

from rpod_campaign.engine.campaign import Campaign
from rpod_campaign.engine.trial.targets import model_of
from rpod_campaign.lidar.cells import methods, ranges_m, steps_of, targets
from rpod_campaign.lidar_robustness import trial
from rpod_campaign.lidar_robustness.options import Options
from rpod_campaign.lidar_robustness.report import sections, summarise
from rpod_campaign.lidar_robustness.trial import DISTURBANCES, RobustnessCell


def cells(options: Options) -> list[RobustnessCell]:
    """Return the cells. Raises ConfigurationError."""
    return [
        RobustnessCell(
            target=target,
            method=method,
            disturbance=disturbance,
            step_deg=step_deg,
            range_m=range_m,
            model=model_of(target, options.model),
            world=world,
        )
        for target in targets(options.target)
        for method in methods(options.method)
        for step_deg in steps_of(method, options.steps)
        for range_m in ranges_m(options, target)
        for disturbance in DISTURBANCES
        for world in options.world
    ]


CAMPAIGN: Campaign[RobustnessCell] = Campaign(
    name="lidar-robustness",
    options=Options,
    cells=cells,
    trial=trial.run,
    schema=trial.SCHEMA,
    summarise=summarise,
    sections=sections,
)
