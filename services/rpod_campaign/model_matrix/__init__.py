"""Targets that differ from their models: acquisition and tracking with each model."""
