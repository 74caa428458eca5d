"""Sequences of frames with truth, for the campaigns that put the navigator or the estimator through them."""
