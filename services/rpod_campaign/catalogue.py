"""All campaigns by name."""

from rpod_campaign.engine.campaign import AnyCampaign
from rpod_campaign.lidar_acquisition import report as lidar_acquisition
from rpod_campaign.lidar_range import report as lidar_range
from rpod_campaign.lidar_robustness import report as lidar_robustness
from rpod_campaign.lidar_tracking import report as lidar_tracking
from rpod_campaign.lidar_trajectory import report as lidar_trajectory
from rpod_campaign.lidar_verdict import report as lidar_verdict
from rpod_campaign.pmd_acquisition import report as pmd_acquisition
from rpod_campaign.pmd_robustness import report as pmd_robustness
from rpod_campaign.pmd_sun import report as pmd_sun
from rpod_campaign.pmd_tracking import report as pmd_tracking
from rpod_campaign.pmd_verdict import report as pmd_verdict

CAMPAIGNS: dict[str, AnyCampaign] = {
    campaign.name: campaign
    for campaign in (
        lidar_acquisition.CAMPAIGN,
        lidar_trajectory.CAMPAIGN,
        lidar_verdict.CAMPAIGN,
        lidar_tracking.CAMPAIGN,
        lidar_robustness.CAMPAIGN,
        lidar_range.CAMPAIGN,
        pmd_tracking.CAMPAIGN,
        pmd_sun.CAMPAIGN,
        pmd_robustness.CAMPAIGN,
        pmd_acquisition.CAMPAIGN,
        pmd_verdict.CAMPAIGN,
    )
}
