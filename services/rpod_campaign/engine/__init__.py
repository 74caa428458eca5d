"""Monte-Carlo campaigns: many trials of the estimator's methods, beside the papers' figures.

A campaign is named cells, each a frozen dataclass of parameters, times trials; a trial is a pure function of
(cell, seed, trial number), so that any core may run it, in any order, and an interrupted campaign resumes.
"""

from rpod_campaign.engine.campaign import AnyCampaign, Campaign, CellResult, Options, Section, Table
from rpod_campaign.engine.folder import CampaignFolder
from rpod_campaign.engine.run import Prepared, prepare, run_campaign

__all__ = [
    "AnyCampaign",
    "Campaign",
    "CampaignFolder",
    "CellResult",
    "Options",
    "Prepared",
    "Section",
    "Table",
    "prepare",
    "run_campaign",
]
