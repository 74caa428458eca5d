"""All campaigns by name."""

from rpod_analysis.campaign import (
    lidar_acquisition,
    lidar_range,
    lidar_robustness,
    lidar_tracking,
    lidar_trajectory,
    lidar_verdict,
    pmd_acquisition,
    pmd_robustness,
    pmd_sun,
    pmd_tracking,
    pmd_verdict,
)
from rpod_analysis.campaign.campaign import AnyCampaign

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
