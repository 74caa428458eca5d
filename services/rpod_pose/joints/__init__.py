"""Targets with joints: their angles are found with the pose."""
