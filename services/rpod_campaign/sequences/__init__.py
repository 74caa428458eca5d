"""Sequences of frames with truth, for the campaigns that run the navigator or the estimator on them."""
