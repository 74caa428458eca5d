"""What the estimator hears: frames, poses of known bodies, the IMU; and which of it was used."""
