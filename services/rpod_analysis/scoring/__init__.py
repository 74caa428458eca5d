"""Scoring of a run: comparison of estimates with the truth, totals, summary, and checks."""
