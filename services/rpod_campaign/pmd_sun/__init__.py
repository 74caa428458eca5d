"""Tracking with a PMD camera under the sun from all directions."""
