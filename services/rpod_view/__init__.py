"""The live view: what the sensors see and the estimator makes of it, in Rerun's viewer."""
