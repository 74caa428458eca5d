"""Worlds: variants in which the target and the sensors differ from their documented physics.

An estimator does not know in which world it is: a world changes how the emulator treats the light, but
neither the sensor's info messages (``LidarInfo``, ``PmdInfo``) nor the target file. If an estimator works
only in the documented world, it is fitted to the emulator, not to the sensor.

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
"""Largest share of the light that a surface reflects."""


class UnknownWorldError(SimSensorError):
    """There is no world of this name."""

    def __init__(self, name: str) -> None:
        super().__init__(f"world is {name!r}; it must be one of {', '.join(WORLDS)}")


class SurfaceWorld(Config):
    """Materials of the target's surfaces."""

    reflection: Literal["documented", "lambertian", "specular"] = "documented"
    """lambertian: the light of the specular lobe is diffuse instead; specular: half of the diffuse
    part goes into the lobe, and the LIDAR's echo falls off with a power of the cosine of incidence."""
    exchanged: bool = False
    """Whether each part has the material after its own in the target file's list of materials."""


class NoiseWorld(Config):
    """Random errors of both sensors."""

    scale: Positive = 1.0
    """Standard deviation over the documented one."""
    degrees_of_freedom: Annotated[float, Field(gt=2)] | None = None
    """Degrees of freedom of Student's distribution, of the same variance; None for normal errors."""

    def draw(self, generator: Generator, shape: int | tuple[int, ...]) -> FloatArray:
        """Return random errors of a shape, in units of the documented standard deviation."""
        if self.degrees_of_freedom is None:
            return self.scale * generator.standard_normal(shape)
        nu = self.degrees_of_freedom
        errors: FloatArray = self.scale * np.sqrt((nu - 2.0) / nu) * generator.standard_t(nu, shape)
        return errors


class CameraWorld(Config):
    """Light that reaches a wrong pixel of a PMD camera, or arrives late."""

    stray_scale: NonNegative = 1.0
    """Stray light over the documented share."""
    glare_share: Share = 0.0
    """Share of a pixel's light that lens and chip scatter into the pixels around it."""
    glare_radius: Positive = 0.05
    """Radius of the glare, as a share of the image's width."""
    bounced_share: Share = 0.0
    """Share of a pixel's light that comes from the surfaces around by a second reflection."""
    bounced_radius: Positive = 0.08
    """Distance of these surfaces in the image, as a share of the image's width."""
    detour_m: NonNegative = 0.0
    """Additional length of its path, one way, which changes its phase."""


class LidarWorld(Config):
    """Detection of a LIDAR, and its false returns."""

    power_scale: Positive = 1.0
    """Power of the laser over the documented one."""
    law: Literal["documented", "soft", "hard"] = "documented"
    """soft: shot noise and an avalanche with an excess noise of 3; hard: an echo is detected exactly if the
    documented law detects it with a probability of half or more."""
    outlier_share: Share | None = None
    """Share of returns with a larger error; None for the documented one."""
    outlier_factor: Annotated[float, Field(ge=1)] = 4.0
    """Error of these returns over that of the others, if ``outlier_share`` is given."""
    footprint_rad: NonNegative = 0.0
    """Width of the beam; if it meets two surfaces, the range may lie between them."""
    mixed_share: Share = 0.5
    """Share of such rays with a mixed range; the others return the range at the beam's middle."""
    bounced_share: Share = 0.0
    """Share of returns by a second reflection, whose range is too long."""
    detour_m: NonNegative = 0.0
    """Mean of the excess length of these ranges, exponentially distributed."""
    false_share: Share = 0.0
    """Share of rays without a surface that return a range by stray light."""

    @property
    def is_documented(self) -> bool:
        """Whether the sensor is the documented one, except for its configuration."""
        return not (self.footprint_rad or self.bounced_share or self.false_share)


class World(Config):
    """One variant of the physics behind the sensors' messages."""

    name: WorldName
    """Name of the world in scenarios and campaigns."""
    about: str
    """Difference from the documented physics, for a line of a table."""
    held_out: bool = False
    """Whether the world is only for reports: no limit or parameter may be chosen by it."""
    surface: SurfaceWorld = SurfaceWorld()
    """The target's materials."""
    noise: NoiseWorld = NoiseWorld()
    """Random errors."""
    camera: CameraWorld = CameraWorld()
    """The PMD camera's light."""
    lidar: LidarWorld = LidarWorld()
    """The LIDAR's detection."""

    def target(self, target: Target) -> Target:
        """Return the target in this world: the same shape, perhaps with other materials."""
        if self.surface.exchanged:
            count = len(target.materials)
            target = replace(target, triangle_material=(target.triangle_material + 1) % count)
        if self.surface.reflection == "documented":
            return target
        made = _lambertian if self.surface.reflection == "lambertian" else _specular
        return replace(target, materials=tuple(made(material) for material in target.materials))

    def camera_config(self, config: PmdConfig) -> PmdConfig:
        """Return the camera's configuration in this world; its info message states the documented one."""
        if self.camera.stray_scale == 1.0:
            return config
        stray_share = min(1.0, self.camera.stray_scale * config.lens.stray_share)
        return config.model_copy(update={"lens": config.lens.model_copy(update={"stray_share": stray_share})})

    def lidar_config(self, config: LidarConfig) -> LidarConfig:
        """Return the LIDAR's configuration in this world; its info message states the documented one."""
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
"""Exponent of the cosine of incidence in the LIDAR's echo from specular surfaces: Phong's lobe around the
direction back. At normal incidence such a surface is (n + 1) / 2 times as bright as a Lambertian one."""


def lidar_cosine(world: World, cos_incidence: FloatArray) -> FloatArray:
    """Return the factor in the echo that replaces the cosine of incidence, any shape."""
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
"""Worlds by name; the first half is for design, the other half only for reports."""

DOCUMENTED = WORLDS["documented"]


def world_of(name: str) -> World:
    """Return a world by its name; raises ``UnknownWorldError`` for an unknown one."""
    if name not in WORLDS:
        raise UnknownWorldError(name)
    return WORLDS[name]
