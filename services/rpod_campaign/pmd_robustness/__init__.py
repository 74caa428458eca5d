"""Tracking with a PMD camera where target and images differ from the model."""
