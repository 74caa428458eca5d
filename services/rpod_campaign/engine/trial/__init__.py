"""What every trial may use: targets, streams of random numbers, poses as columns of a row."""
