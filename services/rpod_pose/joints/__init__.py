"""Targets with joints, whose angles are estimated together with the pose."""
