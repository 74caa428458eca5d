"""All campaigns by name."""

from rpod_analysis.campaign import lidar_acquisition, lidar_trajectory
from rpod_analysis.campaign.campaign import AnyCampaign

CAMPAIGNS: dict[str, AnyCampaign] = {
    campaign.name: campaign for campaign in (lidar_acquisition.CAMPAIGN, lidar_trajectory.CAMPAIGN)
}
