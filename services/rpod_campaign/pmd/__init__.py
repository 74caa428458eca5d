"""Shared parts of the PMD camera's campaigns: scenes, worlds, methods under trial, sequences, tables."""
