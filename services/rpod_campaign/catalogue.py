"""All campaigns by name: those of this package, and those of other packages.

A package provides a campaign by an entry point of the group ``rpod.campaigns`` for a ``Campaign`` object::

    [project.entry-points."rpod.campaigns"]
    my-campaign = "my_package.my_campaign:CAMPAIGN"
"""

from functools import lru_cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points

from rpod_campaign.engine.campaign import AnyCampaign
from rpod_campaign.engine.errors import CampaignUnknownError
from rpod_campaign.engine.options import Options

GROUP = "rpod.campaigns"
BUILT_IN = (
    "lidar-acquisition",
    "lidar-trajectory",
    "lidar-acceptance",
    "lidar-tracking",
    "lidar-robustness",
    "lidar-range",
    "template-tau",
    "pmd-tracking",
    "pmd-sun",
    "pmd-robustness",
    "pmd-acquisition",
    "pmd-acceptance",
    "population",
    "model-matrix",
    "limits",
    "navigation",
    "integrity",
    "faults",
)
"""Names of this package's campaigns; the folder of each has the same name, with underscores."""
RENAMED = {"lidar-verdict": "lidar-acceptance", "pmd-verdict": "pmd-acceptance"}
"""Present names of campaigns by the names that they had before, which the command line still takes."""


def names() -> tuple[str, ...]:
    """Return the names of all campaigns; a built-in one cannot be replaced."""
    return (*BUILT_IN, *(name for name in sorted(_brought()) if name not in BUILT_IN))


@lru_cache(maxsize=64)
def find(name: str) -> AnyCampaign:
    """Return a campaign. Raises ``CampaignUnknownError``."""
    if name in BUILT_IN:
        found: AnyCampaign = import_module(f"{_folder(name)}.campaign").CAMPAIGN
        return found
    brought = _brought()
    if name not in brought:
        raise CampaignUnknownError(name, names())
    campaign: AnyCampaign = brought[name].load()
    return campaign


def options_of(name: str) -> type[Options]:
    """Return the model of a campaign's options, without what its trials need.

    Raises:
        CampaignUnknownError: no campaign has the name.
    """
    if name in BUILT_IN:
        model: type[Options] = import_module(f"{_folder(name)}.options").Options
        return model
    return find(name).options


def _folder(name: str) -> str:
    return f"rpod_campaign.{name.replace('-', '_')}"


def _brought() -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=GROUP)}
