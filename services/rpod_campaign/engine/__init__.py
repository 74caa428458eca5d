"""The engine of the campaigns: it runs trials on any machine, stores their rows, and knows no sensor.

A campaign is named cells, each a frozen dataclass of parameters, times trials; a trial is a pure function of
(cell, seed, trial number), so that any process may run it, in any order, and an interrupted campaign resumes.
"""

from rpod_campaign.engine.campaign import AnyCampaign, Campaign, CellResult, Row
from rpod_campaign.engine.errors import CampaignError
from rpod_campaign.engine.folder import CampaignFolder
from rpod_campaign.engine.options import Names, Options, Ranges, Trials
from rpod_campaign.engine.report.content import Section, Table

__all__ = [
    "AnyCampaign",
    "Campaign",
    "CampaignError",
    "CampaignFolder",
    "CellResult",
    "Names",
    "Options",
    "Ranges",
    "Row",
    "Section",
    "Table",
    "Trials",
]
