"""The estimator service: finds and tracks the target's pose in the sensors' data, and never reads truth."""
