"""LIDAR methods of Opromolla et al., Sensors 15(3), 2015: template matching and ICP."""
