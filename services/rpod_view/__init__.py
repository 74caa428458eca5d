"""The live view: the sensors' data and the estimator's results, in Rerun's viewer."""
