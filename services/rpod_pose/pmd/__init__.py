"""Poses from frames of a PMD camera: search without a guess, tracking, render and compare."""
