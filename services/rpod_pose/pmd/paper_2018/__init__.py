"""The PMD methods of Klionovska et al., Robotics 7(1), 2018: ICP with reverse calibration, EPnP, hybrid."""
