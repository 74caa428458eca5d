"""Tracking with a PMD camera in the 2018 paper's scenarios."""
