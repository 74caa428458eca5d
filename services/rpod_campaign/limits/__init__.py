"""Limits of evidence, derived from a population of random satellites."""
