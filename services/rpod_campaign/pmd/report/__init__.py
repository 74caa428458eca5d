"""Summaries and tables of sequences of images."""
