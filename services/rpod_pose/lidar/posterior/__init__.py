"""Posterior of a pose from a scan: by samples where returns are few, by residuals where they are many."""
