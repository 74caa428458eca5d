"""Worlds: how what the sensors look at, and the sensors themselves, differ from their documented physics.

An estimator is never told in which world it is: a world changes what the emulator makes of the light, and
nothing of what the sensor says of itself (``LidarInfo``, ``PmdInfo``) or of the target's file. An estimator
that works in the documented world alone has learnt the emulator, not the sensor.

Half of the worlds are for design, the other half (``held_out``) only for reporting.
"""

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Annotated, Literal

import numpy as np
from numpy.random import Generator
from pydantic import Field

from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.base import Config, NonNegative, Positive, Share
from rpod_schemas.config.emulator import WorldName
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.config.pmd import PmdConfig
from rpod_sim_sensor.errors import SimSensorError
from rpod_target import Material, Target

_FULLEST = 0.95
"""No surface sends back more than this share of the light."""


class UnknownWorldError(SimSensorError):
    """A world that is not known."""

    def __init__(self, name: str) -> None:
        super().__init__(f"world is {name!r}, needs one of {', '.join(WORLDS)}")


class SurfaceWorld(Config):
    """What the target's surfaces are made of."""

    reflection: Literal["documented", "lambertian", "specular"] = "documented"
    """lambertian: what the camera's lobe would send back is diffuse instead; specular: half of the diffuse
    part goes into the lobe, and the LIDAR's echo falls off with a power of the cosine of incidence."""
    exchanged: bool = False
    """Each part has the material that the target's file gives to the next one in its list of materials."""


class NoiseWorld(Config):
    """Random errors of both sensors."""

    scale: Positive = 1.0
    """Standard deviation over the documented one."""
    degrees_of_freedom: Annotated[float, Field(gt=2)] | None = None
    """Of Student's distribution, whose tails are heavy, with the same variance; None for normal errors."""

    def draw(self, generator: Generator, shape: int | tuple[int, ...]) -> FloatArray:
        """Return errors of this shape in units of the documented standard deviation."""
        if self.degrees_of_freedom is None:
            return self.scale * generator.standard_normal(shape)
        nu = self.degrees_of_freedom
        errors: FloatArray = self.scale * np.sqrt((nu - 2.0) / nu) * generator.standard_t(nu, shape)
        return errors


class CameraWorld(Config):
    """How light reaches the wrong pixel of a PMD camera, or late."""

    stray_scale: NonNegative = 1.0
    """Stray light over the documented share."""
    glare_share: Share = 0.0
    """Share of a pixel's light that lens and chip scatter into the pixels around it."""
    glare_radius: Positive = 0.05
    """How far, as a share of the image's width."""
    bounced_share: Share = 0.0
    """Share of a pixel's light that comes from the surfaces around by a second reflection."""
    bounced_radius: Positive = 0.08
    """From how far, as a share of the image's width."""
    detour_m: NonNegative = 0.0
    """By how much longer its way is, one way: it arrives with another phase."""


class LidarWorld(Config):
    """How a LIDAR detects, and what else it returns."""

    power_scale: Positive = 1.0
    """Power of the laser over the documented one."""
    law: Literal["documented", "soft", "hard"] = "documented"
    """soft: shot noise and an avalanche with an excess noise of 3; hard: every echo is detected of which the
    documented law detects half, no other one."""
    outlier_share: Share | None = None
    """Share of returns with a larger error; None for the documented one."""
    outlier_factor: Annotated[float, Field(ge=1)] = 4.0
    """Their error over that of the others, where ``outlier_share`` says how many they are."""
    footprint_rad: NonNegative = 0.0
    """Width of the beam on the target: where it meets two surfaces, the range may lie between them."""
    mixed_share: Share = 0.5
    """Share of such rays that return a mixed range; the others return that of the beam's middle."""
    bounced_share: Share = 0.0
    """Share of returns that come by a second reflection: they are too long."""
    detour_m: NonNegative = 0.0
    """Mean of what they are too long by, exponential."""
    false_share: Share = 0.0
    """Share of rays without a surface that return a range all the same: stray light."""

    @property
    def is_documented(self) -> bool:
        """Whether nothing but the configuration differs from the documented sensor."""
        return not (self.footprint_rad or self.bounced_share or self.false_share)


class World(Config):
    """One variant of the physics behind the sensors' messages."""

    name: WorldName
    """Under which scenarios and campaigns ask for it."""
    about: str
    """What differs, in a line of a table."""
    held_out: bool = False
    """Whether it is only reported, and no limit or parameter may be chosen by it."""
    surface: SurfaceWorld = SurfaceWorld()
    """The target's materials."""
    noise: NoiseWorld = NoiseWorld()
    """Random errors."""
    camera: CameraWorld = CameraWorld()
    """The PMD camera's light."""
    lidar: LidarWorld = LidarWorld()
    """The LIDAR's detection."""

    def target(self, target: Target) -> Target:
        """Return the target as this world has it: the same shape, perhaps of other materials."""
        if self.surface.exchanged:
            count = len(target.materials)
            target = replace(target, triangle_material=(target.triangle_material + 1) % count)
        if self.surface.reflection == "documented":
            return target
        made = _lambertian if self.surface.reflection == "lambertian" else _specular
        return replace(target, materials=tuple(made(material) for material in target.materials))

    def camera_config(self, config: PmdConfig) -> PmdConfig:
        """Return the camera that makes the frames, which need not be the one that it says it is."""
        if self.camera.stray_scale == 1.0:
            return config
        stray_share = min(1.0, self.camera.stray_scale * config.lens.stray_share)
        return config.model_copy(update={"lens": config.lens.model_copy(update={"stray_share": stray_share})})

    def lidar_config(self, config: LidarConfig) -> LidarConfig:
        """Return the LIDAR that makes the scans, which need not be the one that it says it is."""
        mine, changes = self.lidar, dict[str, Config]()
        if mine.power_scale != 1.0:
            power_W = mine.power_scale * config.transmitter.average_power_W
            changes["transmitter"] = config.transmitter.model_copy(update={"average_power_W": power_W})
        if mine.law == "soft":
            soft = {"shot_noise": True, "gain_on_variance": "squared", "excess_noise_factor": 3.0}
            changes["detection"] = config.detection.model_copy(update=soft)
        if mine.outlier_share is not None:
            outliers = {"outlier_share": mine.outlier_share, "outlier_factor": mine.outlier_factor}
            changes["noise"] = config.noise.model_copy(update=outliers)
        return config.model_copy(update=changes) if changes else config


def _lambertian(material: Material) -> Material:
    diffuse = min(material.diffuse + material.f0, _FULLEST)
    return replace(material, diffuse=diffuse, f0=0.0, crinkle_deg=0.0)


def _specular(material: Material) -> Material:
    half = 0.5 * material.diffuse
    return replace(material, diffuse=half, f0=min(material.f0 + half, _FULLEST))


SPECULAR_POWER = 6.0
"""Exponent of the cosine of incidence in the LIDAR's echo from specular surfaces: Phong's lobe around the way
back. Seen squarely, such a surface is (n + 1) / 2 times as bright as a Lambertian one."""


def lidar_cosine(world: World, cos_incidence: FloatArray) -> FloatArray:
    """Return what stands in the echo for the cosine of incidence, any shape."""
    if world.surface.reflection != "specular":
        return cos_incidence
    n = SPECULAR_POWER
    return 0.5 * cos_incidence + 0.5 * 0.5 * (n + 1.0) * cos_incidence**n


def _of(*worlds: World) -> Mapping[str, World]:
    return MappingProxyType({world.name: world for world in worlds})


WORLDS: Mapping[str, World] = _of(
    World(name="documented", about="the sensors as they are documented"),
    World(
        name="lambertian",
        about="no lobe: foil and metal are white and diffuse",
        surface=SurfaceWorld(reflection="lambertian"),
    ),
    World(
        name="noisy",
        about="20 % more noise, Student's tails (4 degrees of freedom)",
        noise=NoiseWorld(scale=1.2, degrees_of_freedom=4.0),
    ),
    World(
        name="multipath",
        about="8 % of the camera's light has a detour of 0.3 m; a wide LIDAR beam, 4 % of ranges too long",
        camera=CameraWorld(bounced_share=0.08, detour_m=0.3),
        lidar=LidarWorld(footprint_rad=np.radians(0.2), bounced_share=0.04, detour_m=1.0),
    ),
    World(
        name="faint",
        about="40 % of the laser's power, shot noise and excess noise: a soft threshold",
        lidar=LidarWorld(power_scale=0.4, law="soft"),
    ),
    World(
        name="specular",
        about="half of the diffuse light goes into the lobe",
        held_out=True,
        surface=SurfaceWorld(reflection="specular"),
    ),
    World(
        name="stray-light",
        about="ten times the stray light, 5 % lens glare; 0.5 % of the LIDAR's empty rays return a range",
        held_out=True,
        camera=CameraWorld(stray_scale=10.0, glare_share=0.05),
        lidar=LidarWorld(false_share=0.005),
    ),
    World(
        name="exchanged",
        about="materials exchanged between the parts",
        held_out=True,
        surface=SurfaceWorld(exchanged=True),
    ),
    World(
        name="keen",
        about="three times the laser's power, a hard threshold",
        held_out=True,
        lidar=LidarWorld(power_scale=3.0, law="hard"),
    ),
    World(
        name="outliers",
        about="15 % of the LIDAR's returns with six times the error",
        held_out=True,
        lidar=LidarWorld(outlier_share=0.15, outlier_factor=6.0),
    ),
)
"""By name; the first half is for design, the other half only for reporting."""

DOCUMENTED = WORLDS["documented"]


def world_of(name: str) -> World:
    """Return a world by its name. Raises UnknownWorldError."""
    if name not in WORLDS:
        raise UnknownWorldError(name)
    return WORLDS[name]
