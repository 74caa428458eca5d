"""Differences between mounts, from the evidence of the estimator's integrity to the summary."""

from rpod_analysis.scoring.mounts import mount_differences

NAME = "mount_of_front_pmd_from_lidar"
EVIDENCE = {
    f"{NAME}_x_m": 0.012, f"{NAME}_y_m": -0.016, f"{NAME}_z_m": 0.0,
    f"{NAME}_about_x_deg": 0.18, f"{NAME}_about_y_deg": 0.0, f"{NAME}_about_z_deg": 0.24,
    f"{NAME}_sigma_x_m": 0.001, f"{NAME}_sigma_y_m": 0.002, f"{NAME}_sigma_z_m": 0.003,
    f"{NAME}_sigma_about_x_deg": 0.01, f"{NAME}_sigma_about_y_deg": 0.02, f"{NAME}_sigma_about_z_deg": 0.03,
}  # fmt: skip


def test_a_difference_is_read_by_the_names_of_its_sensors() -> None:
    found = mount_differences({**EVIDENCE, "pmd_stamps_late_s": 0.1})
    assert list(found) == ["lidar and front_pmd"]
    difference = found["lidar and front_pmd"]
    assert difference.position_m == (0.012, -0.016, 0.0)
    assert difference.attitude_sigma_deg == (0.01, 0.02, 0.03)
    assert "12.0 (sigma 1.0), -16.0 (sigma 2.0)" in difference.text
    assert "which of them is wrong is not known" in difference.text


def test_evidence_that_is_not_whole_is_no_difference() -> None:
    assert mount_differences({name: value for name, value in EVIDENCE.items() if "about_y" not in name}) == {}
    assert mount_differences({**EVIDENCE, f"{NAME}_x_m": float("nan")}) == {}
