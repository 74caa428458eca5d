"""Inputs of the estimator: frames, poses of known bodies, the IMU; and which of them were used."""
