"""Inputs of the estimator: frames, poses of known bodies, the IMU, and the account of which were used."""
