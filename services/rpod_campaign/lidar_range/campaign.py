"""``lidar-range``: its cells, and the campaign as one object."""

from rpod_campaign.engine.campaign import Campaign
from rpod_campaign.engine.trial.targets import model_of
from rpod_campaign.lidar.cells import methods, ranges_m, steps_of, targets
from rpod_campaign.lidar_range import trial
from rpod_campaign.lidar_range.options import Options
from rpod_campaign.lidar_range.report import sections, summarise
from rpod_campaign.lidar_range.trial import RangeCell
from rpod_schemas.errors import ConfigurationError


def cells(options: Options) -> list[RangeCell]:
    """Return the cells. Raises ConfigurationError."""
    return [
        RangeCell(
            target=target,
            method=method,
            detection=detection,
            scan_step_deg=scan_step_deg,
            step_deg=step_deg,
            range_m=range_m,
            model=model_of(target, options.model),
            world=world,
        )
        for target in targets(options.target)
        for method in methods(options.method)
        for step_deg in steps_of(method, options.steps)
        for detection in ("off", "on")
        for scan_step_deg in _scan_steps(options)
        for range_m in ranges_m(options, target)
        for world in options.world
    ]


def _scan_steps(options: Options) -> tuple[float, ...]:
    for step_deg in options.scan_steps:
        if abs(2.0 / step_deg - round(2.0 / step_deg)) > 1e-6:
            raise ConfigurationError("--scan-steps", "", f"needs steps that divide 2 deg, not {step_deg:g}")
    return options.scan_steps


CAMPAIGN: Campaign[RangeCell] = Campaign(
    name="lidar-range",
    options=Options,
    cells=cells,
    trial=trial.run,
    schema=trial.SCHEMA,
    summarise=summarise,
    sections=sections,
)
