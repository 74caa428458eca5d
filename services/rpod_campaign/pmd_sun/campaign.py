"""``pmd-sun``: its cells, and the campaign as one object."""

from itertools import product
from typing import Any

import numpy as np

from rpod_campaign.engine.campaign import Campaign
from rpod_campaign.engine.options import either
from rpod_campaign.pmd.cells import methods, scenarios
from rpod_campaign.pmd.options import FRAMES
from rpod_campaign.pmd.sequence import FRAME
from rpod_campaign.pmd.world import World, has_material
from rpod_campaign.pmd_sun import trial
from rpod_campaign.pmd_sun.options import Options
from rpod_campaign.pmd_sun.report import sections, summarise
from rpod_campaign.pmd_sun.trial import SunCell
from rpod_schemas.config.base import check
from rpod_schemas.config.scenario import Scenario

_ANGLES_DEG = (0.0, 30.0, 60.0, 90.0, 120.0, 150.0, 180.0)
_AZIMUTHS_DEG = (0.0, 90.0, 180.0, 270.0)


def cells(options: Options) -> list[SunCell]:
    """Return the cells. Raises ConfigurationError, which names the option."""
    return [
        SunCell(
            scenario=name,
            method=method,
            radius_px=radius_px,
            frames=frames,
            through="tracker",
            document=lit(scenario, angle_deg, azimuth_deg).model_dump_json(),
            target=scenario.target,
            model=scenario.estimator.target or "",
            case=coat,
            world=World(coat=None if coat == "as-built" else coat),
            angle_deg=angle_deg,
            azimuth_deg=azimuth_deg,
        )
        for name, scenario in scenarios(options, ranges=options.ranges)
        for frames in either(options.frames, FRAMES)
        for method, radius_px in methods(options.method, options.radius)
        for coat in options.case
        if coat == "as-built" or has_material(scenario.target, coat)
        for angle_deg, azimuth_deg in product(_ANGLES_DEG, _AZIMUTHS_DEG)
        if azimuth_deg == 0.0 or 0.0 < angle_deg < 180.0  # once if all azimuths are the same
    ]


def lit(scenario: Scenario, angle_deg: float, azimuth_deg: float) -> Scenario:
    """Return a scenario with another direction of the sun, as seen at the epoch."""
    angle, azimuth = np.deg2rad((angle_deg, azimuth_deg))
    across = np.sin(angle)
    direction = [across * np.cos(azimuth), across * np.sin(azimuth), np.cos(angle)]
    document: dict[str, Any] = scenario.model_dump(mode="json")
    document["motion"]["sun"] = (document["motion"]["sun"] or {}) | {"direction": direction}
    return check(Scenario, document, source=scenario.name)


CAMPAIGN: Campaign[SunCell] = Campaign(
    name="pmd-sun",
    options=Options,
    cells=cells,
    trial=trial.run,
    schema=trial.SCHEMA,
    summarise=summarise,
    sections=sections,
    keys=(FRAME,),
)
