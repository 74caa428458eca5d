"""Values that the 2015 paper prints in its prose and tables and that a campaign can be compared with.

Source: R. Opromolla, G. Fasano, G. Rufino, M. Grassi, A Model-Based 3D Template Matching Technique for Pose
Acquisition of an Uncooperative Space Object, Sensors 15(3), 2015, 6360-6382. The values are from its text
without the figures: a value that only a figure shows is missing here, and its column stays blank.
"""

from dataclasses import dataclass
from typing import NamedTuple

TM, FAST_TM = "template-matching", "fast-template-matching"
CITATION = "Opromolla et al., Sensors 15(3), 2015"


@dataclass(frozen=True)
class Printed:
    """One number as it is printed."""

    text: str
    """Text of the number, with the words that qualify it."""
    section: str

    def __str__(self) -> str:
        return self.text


class RangeKey(NamedTuple):
    """A cell of Fig. 8."""

    method: str
    range_m: float
    step_deg: float


class StepKey(NamedTuple):
    """A cell of the figures and tables over the trajectory."""

    method: str
    step_deg: float


RANDOM_SUCCESS = {
    RangeKey(TM, 20.0, 60.0): Printed("0.65", "4.4, Fig. 8"),
    RangeKey(TM, 20.0, 10.0): Printed("0.97", "4.4, Fig. 8"),
    RangeKey(TM, 40.0, 60.0): Printed("0.61", "4.4, Fig. 8"),
    RangeKey(TM, 40.0, 10.0): Printed("0.70", "4.4, Fig. 8"),
    RangeKey(TM, 20.0, 30.0): Printed("0.88", "4.4, Fig. 8"),
    RangeKey(TM, 50.0, 30.0): Printed("0.68", "4.4, Fig. 8"),
}
"""Success rate SR_TM at random attitudes, with 500 sets of Euler angles at each range."""

RANDOM_LOSS = {
    (20.0, 60.0): Printed("0.099", "4.4, Fig. 8"),
    (20.0, 40.0): Printed("< 0.01", "4.4, Fig. 8"),
    (20.0, 30.0): Printed("< 0.01", "4.4, Fig. 8"),
    (20.0, 20.0): Printed("-0.004", "4.4, Fig. 8"),
    (20.0, 10.0): Printed("< 0.01", "4.4, Fig. 8"),
    (30.0, 60.0): Printed("0.23", "4.4, Fig. 8"),
    (30.0, 10.0): Printed("0.039", "4.4, Fig. 8"),
}
"""Difference SR_TM - SR_fast-TM at random attitudes, by range in m and step in deg."""

RETURNS = {20.0: Printed("about 490", "4.4"), 50.0: Printed("about 120", "4.4")}
"""Mean number of points of a cloud, by range in m."""

TRAJECTORY_SUCCESS = {
    10.0: Printed("about 0.76", "4.4, Fig. 6"),
    20.0: Printed("above 0.70", "4.4, Fig. 6"),
    30.0: Printed("above 0.70; 0.72; about 0.78", "4.4, Fig. 6; 4.5; Conclusions"),
    60.0: Printed("0.59", "4.4, Fig. 6"),
}
"""Success rate SR_TM over the trajectory, nearest neighbour, by step in deg."""

TRAJECTORY_SUCCESSES = {10.0: 184, 20.0: 177, 30.0: 173, 40.0: 163, 60.0: 142}
"""Number of successful poses out of 241 (Table 2), by step in deg."""

TRAJECTORY_POSITIONS = 241
"""Number of positions on the trajectory (section 4.3)."""

TRAJECTORY_LOSS = {
    10.0: Printed("about 0.01", "4.4, Fig. 7"),
    20.0: Printed("about 0.01", "4.4, Fig. 7"),
    30.0: Printed("0.14", "4.4, Fig. 7"),
    40.0: Printed("0.10", "4.4, Fig. 7"),
    60.0: Printed("0.22", "4.4, Fig. 7"),
}
"""Difference SR_TM - SR_fast-TM over the trajectory, by step in deg."""

EXCLUDED = Printed("about 0.66", "4.4, Fig. 7; Conclusions")
"""Share of the templates that the fast variant leaves out, at any step."""

TIME_SAVED = Printed("about 0.15", "4.4, Fig. 7; Conclusions")
"""Share of the time that the fast variant saves."""

TEMPLATES = {
    10.0: Printed("about 26,000", "4.4, Fig. 6"),
    30.0: Printed("about 1,100", "Conclusions"),
    60.0: Printed("196", "4.4, Fig. 6"),
}
"""Number of templates, by step in deg."""

TIME_S = {
    10.0: Printed("145", "4.4, Fig. 6"),
    20.0: Printed("20", "4.4, Fig. 6"),
    30.0: Printed("7", "4.4, Fig. 6; 4.5"),
    60.0: Printed("1", "4.4, Fig. 6"),
}
"""Time of a search in MATLAB on an i7 at 3.4 GHz, s, by step in deg."""


class EulerErrors(NamedTuple):
    """A column of Table 2, deg."""

    roll: float
    pitch: float
    yaw: float


EULER_ERRORS = {
    10.0: EulerErrors(9.73, 6.17, 21.40),
    20.0: EulerErrors(14.04, 6.88, 22.70),
    30.0: EulerErrors(13.83, 8.15, 37.45),
    40.0: EulerErrors(39.83, 14.50, 47.62),
    60.0: EulerErrors(56.88, 18.97, 78.45),
}
"""Average errors of the template's Euler angles over the successes, on-line TM, by step in deg (Table 2)."""

POSITION_ERRORS = {
    (True, 10.0): (2.809, 1.324, 1.924),
    (True, 20.0): (2.697, 1.268, 1.936),
    (True, 30.0): (2.689, 1.251, 1.868),
    (True, 40.0): (2.772, 1.343, 1.808),
    (True, 60.0): (2.853, 1.369, 1.868),
    (False, 10.0): (4.021, 1.588, 4.698),
    (False, 20.0): (4.198, 1.714, 4.360),
    (False, 30.0): (4.130, 1.732, 4.390),
    (False, 40.0): (3.773, 1.478, 4.192),
    (False, 60.0): (3.443, 1.412, 3.601),
}
"""Average errors of the centroid along x, y, z of the sensor, m, by success and step in deg (Table 3)."""

COSTS = {
    StepKey(TM, 10.0): (0.1882, 1.4620, 0.0023, 0.0012),
    StepKey(TM, 20.0): (0.1882, 1.4738, 0.0023, 0.0012),
    StepKey(TM, 30.0): (0.1852, 1.5309, 0.0023, 0.0012),
    StepKey(TM, 40.0): (0.1539, 1.3478, 0.0026, 0.0012),
    StepKey(TM, 60.0): (0.1254, 1.6681, 0.0029, 0.0013),
    StepKey(FAST_TM, 10.0): (0.3086, 1.5513, 0.0023, 0.0012),
    StepKey(FAST_TM, 20.0): (0.3513, 1.6901, 0.1702, 0.0022),
    StepKey(FAST_TM, 30.0): (0.1254, 1.4034, 0.0023, 0.0012),
    StepKey(FAST_TM, 40.0): (0.1539, 1.4273, 0.0027, 0.0013),
    StepKey(FAST_TM, 60.0): (0.1254, 1.7980, 0.0026, 0.0012),
}
"""Costs f_CONV over the trajectory, m2: least and mean of the failures, greatest and mean of the successes
(Table 4)."""

COSTS_IN_PROSE = Printed(
    "successes a few square millimetres, failures from 10 square centimetres (Fig. 9); Table 4 contradicts "
    "both and is used here",
    "4.5",
)
