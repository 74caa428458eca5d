"""Shared parts of the LIDAR campaigns: scenes, methods under trial, columns of a row."""
