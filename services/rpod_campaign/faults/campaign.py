"""``faults``: its cells, and the campaign as one object."""

from rpod_campaign.engine.campaign import Campaign
from rpod_campaign.engine.trial.names import require
from rpod_campaign.faults import trial
from rpod_campaign.faults.cell import FaultCell
from rpod_campaign.faults.matrix import BY_FAULT, can_have
from rpod_campaign.faults.options import Options
from rpod_campaign.faults.report import sections, summarise
from rpod_campaign.faults.trial import FRAME
from rpod_campaign.lidar.cells import targets
from rpod_campaign.sequences.cells import document_of


def cells(options: Options) -> list[FaultCell]:
    """Return the cells: faults with their sizes and durations. Raises ConfigurationError."""
    for name in options.fault:
        require("--fault", name, BY_FAULT)
    return [
        FaultCell(
            fault=name,
            size=size,
            lasts_s=lasts_s,
            target=target,
            sensor=sensor,
            world=world,
            document=document_of(options.scenarios, sensor, target, world),
        )
        for target in targets(options.target)
        for sensor in options.sensor
        for world in options.world
        for name in options.fault
        if can_have(sensor, name)
        for size, lasts_s in BY_FAULT[name].cells
    ]


CAMPAIGN: Campaign[FaultCell] = Campaign(
    name="faults",
    options=Options,
    cells=cells,
    trial=trial.run,
    schema=trial.SCHEMA,
    summarise=summarise,
    sections=sections,
    keys=(FRAME,),
)
