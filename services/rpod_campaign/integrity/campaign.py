"""``integrity``: its cells, and the campaign as one object."""

from rpod_campaign.engine.campaign import Campaign
from rpod_campaign.engine.trial.names import require
from rpod_campaign.integrity import trial
from rpod_campaign.integrity.cell import IntegrityCell
from rpod_campaign.integrity.faults import BY_NAME, FAULT_NAMES
from rpod_campaign.integrity.options import Options
from rpod_campaign.integrity.report import sections, summarise, totals
from rpod_campaign.integrity.trial import FRAME
from rpod_campaign.lidar.cells import targets
from rpod_campaign.sequences.cells import document_of


def cells(options: Options) -> list[IntegrityCell]:
    """Return the cells: faults with their sizes, targets, sensors, worlds. Raises ConfigurationError."""
    for name in options.fault:
        require("--fault", name, FAULT_NAMES)
    return [
        IntegrityCell(
            fault=name,
            size=size,
            target=target,
            sensor=sensor,
            world=world,
            camera_hz=options.rate,
            document=document_of(options.scenarios, sensor, target, world),
        )
        for target in targets(options.target)
        for sensor in options.sensor
        for world in options.world
        for name in options.fault
        for size in sizes_of(name, sensor)
    ]


def sizes_of(fault: str, sensor: str) -> tuple[float, ...]:
    """Return the sizes of a fault; with both sensors the middle one, since a sequence takes the longest."""
    sizes = BY_NAME[fault].sizes
    return (sizes[len(sizes) // 2],) if sensor == "both" else sizes


CAMPAIGN: Campaign[IntegrityCell] = Campaign(
    name="integrity",
    options=Options,
    cells=cells,
    trial=trial.run,
    schema=trial.SCHEMA,
    summarise=summarise,
    sections=sections,
    totals=totals,
    keys=(FRAME,),
)
