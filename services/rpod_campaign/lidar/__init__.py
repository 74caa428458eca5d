"""What the LIDAR campaigns share: scenes, methods under trial, columns of a row."""
