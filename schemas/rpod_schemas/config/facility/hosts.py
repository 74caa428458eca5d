"""A facility that stays up: the services of one host, and how each is kept alive (``rpod up``)."""

from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field, model_validator

from rpod_schemas.config.base import Config, Name, Positive
from rpod_schemas.config.service import BusConfig

Verb = Literal["router", "motion", "emulator", "estimator", "logger", "driver", "view", "proxy"]
Restart = Literal["always", "on_failure", "never"]

_FINITE: tuple[Verb, ...] = ("motion", "driver", "view")
"""Services that may come to an end by themselves: a scenario, a recording, a window that is closed."""

_RESERVED: tuple[Verb, ...] = ("router", "estimator", "emulator", "motion", "logger")
"""Services that touch nothing but the bus and their own files, and these only when their turn has come. A
driver opens its device."""


class BackoffConfig(Config):
    """Waits before a service is started again."""

    first_s: Positive = 0.1
    """Wait before the first restart, s; it doubles with each further one."""
    max_s: Positive = 30.0
    """Longest wait, s."""
    steady_s: Positive = 60.0
    """Time that a service has to be at work for the next wait to be the first one again, s."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.max_s < self.first_s:
            raise ValueError(
                f"max_s is {self.max_s:g}, shorter than first_s, {self.first_s:g}: raise it, or lower first_s"
            )
        return self


class FacilityService(Config):
    """One service that is kept alive."""

    verb: Verb
    """Verb of the command line that starts it: ``rpod <verb>``."""
    driver: Name | None = None
    """Name of the driver, for ``verb: driver``; ``rpod driver list`` shows them."""
    config: Path | dict[str, Any] = Field(default_factory=dict)
    """Its configuration: a file, relative to this one, or the fields themselves. ``bus`` below fills in what
    it leaves out of its own ``bus``."""
    restart: Restart | None = None
    """Policy by which it is started again: always, on_failure (not after exit code 0), or never. The default
    is on_failure for motion, driver and view, whose source may end, and always for the others. After exit
    code 2, a wrong configuration, it is never started again."""
    start_timeout_s: Positive = 300.0
    """Longest time until it is at work, s; the first start on a machine compiles kernels. A driver may wait
    for its device without limit."""
    hang_s: Positive = 120.0
    """Time without a turn of its main loop after which it is killed and started again, s. A first pose with
    joints takes up to 90 s."""

    reserve: bool = False
    """Whether a second process waits, warm and not on the bus, to take over in a fraction of a second when
    the first one ends. It takes as much memory as the first one. For router, estimator, emulator, motion,
    logger."""

    @model_validator(mode="after")
    def _reserve_is_possible(self) -> Self:
        if self.reserve and self.verb not in _RESERVED:
            known = ", ".join(_RESERVED)
            raise ValueError(f"reserve: not for verb {self.verb}, only for {known}; leave it out")
        return self

    @model_validator(mode="after")
    def _driver_has_a_name(self) -> Self:
        if self.verb == "driver" and self.driver is None:
            raise ValueError(
                "driver: is missing; with `verb: driver` give the driver's name, as `driver: ifm` "
                "('rpod driver list' shows them)"
            )
        if self.verb != "driver" and self.driver is not None:
            raise ValueError("driver: only `verb: driver` takes `driver`; remove it")
        return self

    @property
    def restarts(self) -> Restart:
        """Policy by which it is started again."""
        return self.restart or ("on_failure" if self.verb in _FINITE else "always")


class FacilityFile(Config):
    """The services of one host."""

    name: Name
    """Name of the facility, for tables and log lines."""
    bus: BusConfig = BusConfig(wait=True)
    """Bus of all services that do not say otherwise; the endpoint on which a router listens by default."""
    services: dict[Name, FacilityService] = Field(min_length=1)
    """Services by name, which is also the default of their ``instance``. They start in this order and stop in
    the reverse one, so that receivers are named before publishers."""
    backoff: BackoffConfig = BackoffConfig()
    """Waits before a service is started again."""
    state: Path | None = None
    """Folder of configurations, log lines and the state, relative to this file; by default beside it, with
    the ending ``.state``."""
