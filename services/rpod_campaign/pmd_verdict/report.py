"""``pmd-verdict``: right poses that are refused, and frames of something else that are believed."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import polars as pl

from rpod_campaign.engine.campaign import Campaign, CellResult, Options, Section, Table
from rpod_campaign.engine.statistics import rate
from rpod_campaign.papers import paper_2018 as paper
from rpod_campaign.pmd.cells import scenarios
from rpod_campaign.pmd.world import World
from rpod_campaign.pmd_verdict import trial
from rpod_campaign.pmd_verdict.trial import OFF_DEG, OFF_M, VerdictCell
from rpod_schemas.config.base import check
from rpod_schemas.config.scenario import Scenario
from rpod_schemas.errors import ConfigurationError

Results = Sequence[CellResult[VerdictCell]]

_RANGE_M = (2.1, 7.0)
_JUDGES = ("acquisition", "tracker")
_AS_BUILT = World(cad_error_m=1e-3)


@dataclass(frozen=True)
class Case:
    """What a frame shows, and how it is spoiled."""

    world: World = _AS_BUILT
    target: str | None = None
    """None for the one that is looked for."""
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
"""By the names of the command line; the mock-up is 1 mm off where nothing else is said."""


def cells(options: Options) -> list[VerdictCell]:
    """Return the cells. Raises ConfigurationError, which names the option."""
    names = options.case or tuple(CASES)
    for name in names:
        if name not in CASES:
            raise ConfigurationError("--case", "", f"needs {', '.join(CASES)}, not {name!r}")
    ranges_m = options.ranges or _RANGE_M
    return [
        VerdictCell(
            case=name,
            document=_taken(scenario, CASES[name].profile).model_dump_json(),
            target=CASES[name].target or scenario.target,
            range_m=(min(ranges_m), max(ranges_m)),
            world=CASES[name].world,
            flip=CASES[name].flip,
            focal_share=CASES[name].focal_share,
            sun=CASES[name].sun,
        )
        for _, scenario in scenarios(options, (paper.TUMBLING,))
        for name in names
    ]


def _taken(scenario: Scenario, profile: str) -> Scenario:
    """Return a scenario whose camera has an exposure profile, at a rate that all of them allow."""
    document: dict[str, Any] = scenario.model_dump(mode="json")
    for sensor in document["sensors"]:
        if sensor["kind"] == "pmd":
            sensor |= {"profile": profile, "rate_hz": 15.0}
    return check(Scenario, document, source=scenario.name)


def summarise(cell: VerdictCell, rows: pl.DataFrame) -> dict[str, Any]:
    """Return what is said of a cell: numbers of trials."""
    parameters = asdict(cell)
    del parameters["document"]
    counts: dict[str, Any] = {}
    for judge in _JUDGES:
        accepted, right = rows[f"{judge}_accepted"], rows[f"{judge}_right"]
        alike = rows[f"{judge}_alike"].fill_null(value=False)
        counts |= {
            f"{judge}_accepted": int(accepted.sum()),
            f"{judge}_accepted_alike": int((accepted & alike).sum()),
            f"{judge}_right": int(right.sum()),
            f"{judge}_right_refused": int((right & ~accepted).sum()),
            f"{judge}_wrong_accepted": int((accepted & ~right).sum()),
        }
    counts["tracked_after"] = int(rows["tracked_after"].sum())
    return {**parameters, "spoiled": cell.spoiled, "trials": rows.height, **counts}


def sections(results: Results) -> list[Section]:
    """Return the report."""
    note = (
        "One frame each, any attitude, the sun anywhere, depth not calibrated. The acquisition has no guess, "
        f"the tracker starts {OFF_DEG:g} deg and {1e2 * OFF_M:g} cm beside the truth, whatever is there. "
    )
    right = [result for result in results if not result.cell.spoiled]
    spoiled = [result for result in results if result.cell.spoiled]
    told = "Right: within 4 deg and 8 cm. What is ambiguous is not accepted. 95 % Wilson bounds."
    alike = (
        "No pose is right. Alike: at the pose found the target gives the same ranges and outline, but for "
        "3 cm, as what is really there, so that only materials and motion can tell them apart."
    )
    return [
        *([Section("Right frames", note + told, (_right_table(right),))] if right else []),
        *([Section("Frames of something else", note + alike, (_spoiled_table(spoiled),))] if spoiled else []),
    ]


def _right_table(results: Results) -> Table:
    rows = [
        (
            result.cell.case,
            judge,
            f"{s['trials'] - s[f'{judge}_accepted']} of {s['trials']}",
            str(rate(s["trials"] - s[f"{judge}_accepted"], s["trials"])),
            str(s[f"{judge}_wrong_accepted"]),
        )
        for result in results
        for judge in _JUDGES
        for s in (result.summary,)
    ]
    columns = ("case", "judge", "not accepted", "share", "wrong accepted")
    return Table("Right frames not accepted", columns, tuple(rows)).condensed(2)


def _spoiled_table(results: Results) -> Table:
    rows = [
        (
            result.cell.case,
            judge,
            f"{s[f'{judge}_accepted']} of {s['trials']}",
            str(rate(s[f"{judge}_accepted"], s["trials"])),
            str(s[f"{judge}_accepted_alike"]),
        )
        for result in results
        for judge in _JUDGES
        for s in (result.summary,)
    ]
    columns = ("case", "judge", "accepted", "share", "of these alike")
    return Table("Frames of something else accepted", columns, tuple(rows)).condensed(2)


CAMPAIGN: Campaign[VerdictCell] = Campaign(
    name="pmd-verdict",
    title="Verdicts on frames of the target and of something else",
    trials=100,
    accepts=frozenset({"scenario", "ranges", "case"}),
    cells=cells,
    trial=trial.run,
    schema=trial.SCHEMA,
    summarise=summarise,
    sections=sections,
)
