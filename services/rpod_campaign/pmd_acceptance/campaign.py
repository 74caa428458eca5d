"""``pmd-acceptance``: its cells, and the campaign as one object."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rpod_campaign.engine.campaign import Campaign
from rpod_campaign.pmd.cells import chosen, ranges_m, scenarios
from rpod_campaign.pmd.world import World, has_material
from rpod_campaign.pmd_acceptance import trial
from rpod_campaign.pmd_acceptance.options import Options
from rpod_campaign.pmd_acceptance.report import sections, summarise
from rpod_campaign.pmd_acceptance.trial import AcceptanceCell
from rpod_schemas.config.base import check
from rpod_schemas.config.scenario import Scenario

_AS_BUILT = World(cad_error_m=1e-3)


@dataclass(frozen=True)
class Case:
    """Content of a frame, and its differences from the target as it is."""

    world: World = _AS_BUILT
    target: str | None = None
    """Name of the target in the frame; None for the one that is searched."""
    sun: str = "anywhere"
    profile: str = "fast"
    flip: str = ""
    focal_share: float = 1.0


CASES: Mapping[str, Case] = {
    "right": Case(),
    "dual": Case(profile="dual"),
    "sun-behind": Case(sun="behind"),
    "depth-lost": Case(World(cad_error_m=1e-3, depth_lost_share=0.6)),
    "glints": Case(World(cad_error_m=1e-3, glint_share=0.4)),
    **{f"all-{coat}": Case(World(coat=coat)) for coat in ("panel", "gold-mli", "silver-mli")},
    "left-right": Case(flip="left-right"),
    "upside-down": Case(flip="upside-down"),
    **{f"focal-{share:g}": Case(focal_share=share) for share in (0.8, 0.9, 1.1, 1.2)},
    **{f"size-{scale:g}": Case(World(scale=scale)) for scale in (0.9, 1.1)},
    **{target: Case(World(), target) for target in ("hexagonal-body", "rocket-stage", "envisat-slim")},
}
"""Cases by their name on the command line; the parts of the mock-up have an error of 1 mm unless stated."""


def cells(options: Options) -> list[AcceptanceCell]:
    """Return the cells. Raises ConfigurationError, which names the option."""
    return [
        AcceptanceCell(
            case=name,
            document=_taken(scenario, CASES[name].profile).model_dump_json(),
            target=CASES[name].target or scenario.target,
            range_m=ranges_m(chosen(options, scenario), scenario),
            world=CASES[name].world,
            flip=CASES[name].flip,
            focal_share=CASES[name].focal_share,
            sun=CASES[name].sun,
        )
        for _, scenario in scenarios(options)
        for name in options.case
        if CASES[name].target != scenario.target and _has_material_of(CASES[name], scenario.target)
    ]


def _has_material_of(case: Case, target: str) -> bool:
    """Return whether a target has the material of a case, if it names one."""
    return case.world.coat is None or has_material(target, case.world.coat)


def _taken(scenario: Scenario, profile: str) -> Scenario:
    """Return a scenario whose camera has an exposure profile, at a rate that all profiles allow."""
    document: dict[str, Any] = scenario.model_dump(mode="json")
    for sensor in document["sensors"]:
        if sensor["kind"] == "pmd":
            sensor |= {"profile": profile, "rate_hz": 15.0}
    return check(Scenario, document, source=scenario.name)


CAMPAIGN: Campaign[AcceptanceCell] = Campaign(
    name="pmd-acceptance",
    options=Options,
    cells=cells,
    trial=trial.run,
    schema=trial.SCHEMA,
    summarise=summarise,
    sections=sections,
)
