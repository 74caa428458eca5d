"""Parts that every trial may use: targets, random numbers, poses as columns of a row."""
