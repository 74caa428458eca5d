"""``lidar-tracking``: its cells, and the campaign as one object."""

from rpod_campaign.engine.campaign import Campaign
from rpod_campaign.engine.trial.targets import model_of
from rpod_campaign.lidar.cells import ranges_m, targets
from rpod_campaign.lidar.methods import tracking_input
from rpod_campaign.lidar_tracking import trial
from rpod_campaign.lidar_tracking.options import Options
from rpod_campaign.lidar_tracking.report import sections, summarise
from rpod_campaign.lidar_tracking.trial import TrackingCell

_RATES_DEG_S = (0.5, 2.0, 4.0, 8.0)


def cells(options: Options) -> list[TrackingCell]:
    """Return single scans at the ranges, then sequences. Raises ConfigurationError."""
    for tracker in options.matcher:
        tracking_input(tracker)
    return [
        TrackingCell(
            target=target,
            tracker=tracker,
            range_m=range_m,
            rate_deg_s=rate_deg_s,
            model=model_of(target, options.model),
            world=world,
            surroundings=surroundings,
        )
        for target in targets(options.target)
        for tracker in options.matcher
        for range_m, rate_deg_s in (
            *((range_m, None) for range_m in ranges_m(options, target)),
            *((None, rate_deg_s) for rate_deg_s in _RATES_DEG_S),
        )
        for world in options.world
        for surroundings in options.surroundings
    ]


CAMPAIGN: Campaign[TrackingCell] = Campaign(
    name="lidar-tracking",
    options=Options,
    cells=cells,
    trial=trial.run,
    schema=trial.SCHEMA,
    summarise=summarise,
    sections=sections,
)
