"""Scoring a run: estimates against truth, totals, the summary, and whether the run went well."""
