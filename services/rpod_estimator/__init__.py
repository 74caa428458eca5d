"""Finds and tracks the target's pose in the sensors' data; never reads truth."""
