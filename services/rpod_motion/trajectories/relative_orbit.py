"""Two orbits about the oblate Earth, the chaser's on a safety ellipse about the target's.

Each orbit is a set of mean elements. The Earth's oblateness turns node, perigee and mean anomaly at constant
rates (its secular effects; D. Brouwer, Solution of the Problem of Artificial Satellite Theory Without Drag,
Astron. J. 64 (1959) 378-397, to first order in J2). Positions follow from Kepler's equation, without any
expansion in the separation. Periodic effects of J2 are left out.

The relative motion is designed by differences of mean elements (G. Fasano, M. D'Errico, Modeling Orbital
Relative Motion to Enable Formation Design from Application Requirements, Celest. Mech. Dyn. Astron. 105
(2009) 113-139; S. D'Amico, O. Montenbruck, Proximity Operations of Formation-Flying Spacecraft Using an
Eccentricity/Inclination Vector Separation, J. Guid. Control Dyn. 29 (2006) 554-563). To first order, in the
target's local frame (x outward along the radius, y along the track, z along the orbit's normal),

    x = -a cos(u - phi),   y = 2 a sin(u - phi),   z = b sin(u - theta),

where u is the argument of latitude, (a, phi) the semi-major axis times the difference of the eccentricity
vectors, (b, theta) the same of the inclination vectors. With theta = phi radial and cross-track motion are in
quadrature and keep the chaser clear of the track, by a or b at least, even where its position along the track
is uncertain: a safety ellipse (D. E. Gaylor, B. W. Barbee, Algorithms for Safe Spacecraft Proximity
Operations, AAS 07-107).
"""

from dataclasses import dataclass
from functools import cached_property
from math import atan2, cos, hypot, pi, sin, sqrt
from typing import NamedTuple, Self

import numpy as np

from rpod_schemas.arrays import FloatArray

EARTH_MU_M3_S2 = 3.986004418e14
"""Gravitational parameter of the Earth (IERS conventions 2010)."""
EARTH_RADIUS_M = 6378136.6
"""Equatorial radius of the Earth (IERS conventions 2010)."""
EARTH_J2 = 1.0826359e-3
"""Dynamical form factor of the Earth (IERS conventions 2010)."""

_KEPLER_RAD = 1e-15
_NODE_PHASE_RAD = pi / 2.0
"""Phase phi = theta of the safety ellipse."""


class OrbitState(NamedTuple):
    """Position and velocity in Earth-centred inertial axes, and attitude and rate of the local frame."""

    position_m: FloatArray
    """Position, shape (3,)."""
    velocity_m_s: FloatArray
    """Velocity, shape (3,)."""
    R_inertial_local: FloatArray
    """Attitude of the local frame, shape (3, 3); its columns are radius, track and normal of the orbit."""
    local_rate_rad_s: FloatArray
    """Rotation rate of the local frame relative to inertial space, local axes, shape (3,)."""


@dataclass(frozen=True)
class MeanOrbit:
    """Mean elements at the epoch."""

    semi_major_axis_m: float
    eccentricity: float
    inclination_rad: float
    node_rad: float
    """Right ascension of the ascending node."""
    perigee_rad: float
    """Argument of perigee."""
    mean_anomaly_rad: float

    @cached_property
    def mean_motion_rad_s(self) -> float:
        """Mean motion by Kepler's third law, without J2."""
        return sqrt(EARTH_MU_M3_S2 / self.semi_major_axis_m) / self.semi_major_axis_m

    @cached_property
    def rates_rad_s(self) -> tuple[float, float, float]:
        """Secular rates of node, perigee and mean anomaly."""
        shape = sqrt(1.0 - self.eccentricity**2)
        parameter_m, c = self.semi_major_axis_m * shape**2, cos(self.inclination_rad)
        strength = 0.75 * EARTH_J2 * (EARTH_RADIUS_M / parameter_m) ** 2 * self.mean_motion_rad_s
        return (
            -2.0 * strength * c,
            strength * (5.0 * c**2 - 1.0),
            self.mean_motion_rad_s + strength * shape * (3.0 * c**2 - 1.0),
        )

    def state(self, time_s: float) -> OrbitState:
        """Return position and its exact derivative at a time from the epoch."""
        a, e, inclination = self.semi_major_axis_m, self.eccentricity, self.inclination_rad
        node_rate, perigee_rate, anomaly_rate = self.rates_rad_s
        E = eccentric_anomaly(self.mean_anomaly_rad + anomaly_rate * time_s, e)
        cos_E, sin_E, shape = cos(E), sin(E), sqrt(1.0 - e * e)
        nearness = 1.0 - e * cos_E
        radius_m, E_rate = a * nearness, anomaly_rate / nearness
        u = self.perigee_rad + perigee_rate * time_s + atan2(shape * sin_E, cos_E - e)
        u_rate = perigee_rate + E_rate * shape / nearness
        node = self.node_rad + node_rate * time_s
        cu, su, ci, si, co, so = cos(u), sin(u), cos(inclination), sin(inclination), cos(node), sin(node)
        axes = np.array(
            [
                [co * cu - so * su * ci, -co * su - so * cu * ci, so * si],
                [so * cu + co * su * ci, -so * su + co * cu * ci, -co * si],
                [su * si, cu * si, ci],
            ]
        )
        rate = (node_rate * si * su, node_rate * si * cu, node_rate * ci + u_rate)
        velocity = np.array([a * e * sin_E * E_rate, radius_m * rate[2], -radius_m * rate[1]])
        return OrbitState(radius_m * axes[:, 0], axes @ velocity, axes, np.array(rate))


def eccentric_anomaly(mean_anomaly_rad: float, eccentricity: float) -> float:
    """Solve Kepler's equation E - e sin E = M by Newton's method from E = M + e sin M."""
    E = mean_anomaly_rad + eccentricity * sin(mean_anomaly_rad)
    for _ in range(20):
        step = (E - eccentricity * sin(E) - mean_anomaly_rad) / (1.0 - eccentricity * cos(E))
        E -= step
        if abs(step) < _KEPLER_RAD:
            break
    return E


@dataclass(frozen=True)
class RelativeOrbit:
    """The orbits of target and chaser."""

    target: MeanOrbit
    chaser: MeanOrbit

    @classmethod
    def safety_ellipse(cls, target: MeanOrbit, *, radial_m: float, cross_track_m: float) -> Self:
        """Return the orbits for a safety ellipse with the amplitudes a and b of the module's docstring.

        The inclination vectors differ only by the nodes, theta = 90 deg, because with different inclinations
        the nodes would drift apart. With equal semi-major axes all rates are then equal to first order, and
        the ellipse neither drifts nor grows; its perigee rotates by 0.4 deg in two orbits of ENVISAT.
        """
        a = target.semi_major_axis_m
        node_difference = cross_track_m / (a * sin(target.inclination_rad))
        difference = radial_m / a
        along = target.eccentricity * cos(target.perigee_rad) + difference * cos(_NODE_PHASE_RAD)
        across = target.eccentricity * sin(target.perigee_rad) + difference * sin(_NODE_PHASE_RAD)
        perigee = atan2(across, along)
        mean_latitude = target.perigee_rad + target.mean_anomaly_rad
        chaser = MeanOrbit(
            semi_major_axis_m=a,
            eccentricity=hypot(along, across),
            inclination_rad=target.inclination_rad,
            node_rad=target.node_rad + node_difference,
            perigee_rad=perigee,
            # compensates the distance of the nodes along the orbit, so that the ellipse is centred
            mean_anomaly_rad=mean_latitude - node_difference * cos(target.inclination_rad) - perigee,
        )
        return cls(target, chaser)

    def separation(self, time_s: float) -> tuple[FloatArray, FloatArray, OrbitState]:
        """Return the chaser's position relative to the target, its local rate, and the target's state.

        Position and rate are in the target's local axes, shape (3,), m and m/s.
        """
        target, chaser = self.target.state(time_s), self.chaser.state(time_s)
        to_local = target.R_inertial_local.T
        separation_m = to_local @ (chaser.position_m - target.position_m)
        inertial_m_s = to_local @ (chaser.velocity_m_s - target.velocity_m_s)
        return separation_m, inertial_m_s - cross(target.local_rate_rad_s, separation_m), target


def mean_latitude_at_phase(phase_rad: float) -> float:
    """Return the mean argument of latitude at which the safety ellipse has the phase u - phi."""
    return phase_rad + _NODE_PHASE_RAD


def cross(left: FloatArray, right: FloatArray) -> FloatArray:
    """Return the cross product of two vectors, shape (3,); numpy's takes ten times as long at this size."""
    a, b, c = left.tolist()
    x, y, z = right.tolist()
    return np.array([b * z - c * y, c * x - a * z, a * y - b * x])
