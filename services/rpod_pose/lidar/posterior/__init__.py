"""Posterior of a pose from a scan: from samples if returns are few, from residuals if they are many."""
