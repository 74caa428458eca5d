"""``lidar-acceptance``: its cells, and the campaign as one object."""

from rpod_campaign.engine.campaign import Campaign
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.lidar.cells import methods, ranges_m, steps_of, targets
from rpod_campaign.lidar_acceptance import trial
from rpod_campaign.lidar_acceptance.options import Options
from rpod_campaign.lidar_acceptance.report import sections, summarise
from rpod_campaign.lidar_acceptance.trial import AcceptanceCell
from rpod_target import is_shipped

_OTHERS = ("envisat-slim", "envisat-bulky", "mockup")
"""Objects that are scanned instead of the target: one of another size, and another body."""


def cells(options: Options) -> list[AcceptanceCell]:
    """Return the cells: each method on scans of the target itself, the global search on others too."""
    return [
        AcceptanceCell(
            target=target,
            scanned_target=scanned,
            method=method,
            step_deg=step_deg,
            range_m=range_m,
            world=world,
        )
        for method in methods(options.method)
        for step_deg in steps_of(method, options.steps)
        for target in targets(options.target)
        for scanned in _scanned(method, target)
        for range_m in _ranges_m(options, target)
        for world in options.world
    ]


def _ranges_m(options: Options, target: str) -> tuple[float, ...]:
    """Return the ranges for the reference; a target of another size is scanned from others."""
    if is_shipped(cached_target(target)):
        return ranges_m(options, target)
    scale = trial.size_m(trial.REFERENCE) / trial.size_m(target)
    return tuple(scale * range_m for range_m in ranges_m(options, target))


def _scanned(method: str, target: str) -> tuple[str, ...]:
    others = tuple(other for other in _OTHERS if other != target)
    return (target, *others) if method == "global" else (target,)


CAMPAIGN: Campaign[AcceptanceCell] = Campaign(
    name="lidar-acceptance",
    options=Options,
    cells=cells,
    trial=trial.run,
    schema=trial.SCHEMA,
    summarise=summarise,
    sections=sections,
)
