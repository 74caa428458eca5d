"""Models of the motion of target and chaser between measurements, behind ``filter.MotionModel``.

``filter.prediction.constant_twist`` is the default: a constant velocity of the centre of mass and a constant
rate, as seen from the chaser, both driven by noise. ``FreeMotion`` models the known part of the motion: the
chaser's rotation and thrust, the relative orbit, and the torque-free rotation of the target. ``options``
creates the model that the configuration states.
"""
