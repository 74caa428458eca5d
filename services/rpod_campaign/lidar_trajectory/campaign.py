"""``lidar-trajectory``: its cells, and the campaign as one object."""

from rpod_campaign.engine.campaign import Campaign
from rpod_campaign.engine.options import either
from rpod_campaign.lidar.cells import methods, targets, variants
from rpod_campaign.lidar.methods import TEMPLATE_MATCHING
from rpod_campaign.lidar.options import EQ4
from rpod_campaign.lidar_trajectory import trial
from rpod_campaign.lidar_trajectory.options import Options
from rpod_campaign.lidar_trajectory.report import sections, summarise
from rpod_campaign.lidar_trajectory.trial import POSITIONS, TrajectoryCell


def cells(options: Options) -> list[TrajectoryCell]:
    """Return the cells. Raises ConfigurationError, which names the option."""
    return [
        TrajectoryCell(
            target=target,
            method=method,
            eq4=eq4,
            centroid=str(centroid),
            step_deg=float(step_deg),
            world=world,
        )
        for target in targets(options.target)
        for method in methods(options.method, tuple(TEMPLATE_MATCHING))
        for step_deg, centroid, _ in variants(
            method, steps=options.steps, centroid=options.centroid, matchers=("normal-shooting",)
        )
        if step_deg is not None
        for eq4 in either(options.eq4, EQ4)
        for world in options.world
    ]


CAMPAIGN: Campaign[TrajectoryCell] = Campaign(
    name="lidar-trajectory",
    options=Options,
    most_trials=POSITIONS,
    cells=cells,
    trial=trial.run,
    schema=trial.SCHEMA,
    summarise=summarise,
    sections=sections,
)
