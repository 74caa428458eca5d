"""From a facility's file to the checked configuration and the command line of each of its services."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from rpod.up.host_state import read_facility
from rpod_schemas.config.base import check, read_document
from rpod_schemas.config.emulator import EmulatorConfig, MotionServiceConfig
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.config.facility.hosts import FacilityFile, FacilityService
from rpod_schemas.config.facility.logger import LoggerConfig
from rpod_schemas.config.facility.proxy import ProxyConfig
from rpod_schemas.config.facility.view import ViewConfig
from rpod_schemas.config.service import RouterConfig
from rpod_schemas.errors import ConfigurationError, SchemaError

_MODELS: dict[str, type[BaseModel]] = {
    "router": RouterConfig,
    "motion": MotionServiceConfig,
    "emulator": EmulatorConfig,
    "estimator": EstimatorConfig,
    "logger": LoggerConfig,
    "view": ViewConfig,
    "proxy": ProxyConfig,
}


@dataclass(frozen=True)
class ResolvedService:
    """One service, ready to be started."""

    name: str
    settings: FacilityService
    config: BaseModel

    def arguments(self, config: Path) -> list[str]:
        """Return the arguments of ``rpod`` for a configuration file."""
        if self.settings.driver is not None:
            return ["driver", "run", self.settings.driver, str(config)]
        return [self.settings.verb, "--config", str(config)]


@dataclass(frozen=True)
class ResolvedFacility:
    """A facility whose services are all checked."""

    path: Path
    file: FacilityFile
    state: Path
    """Folder of configurations, log lines and the state."""
    services: tuple[ResolvedService, ...]


def resolve_facility(path: Path) -> ResolvedFacility:
    """Return a facility with the configuration of each service. Raises ``ConfigurationError``."""
    file, state = read_facility(path)
    services = tuple(_resolve(path, file, name, service) for name, service in file.services.items())
    instances = [getattr(service.config, "instance", service.name) for service in services]
    for service, instance in zip(services, instances, strict=True):
        if instances.count(instance) > 1:
            raise ConfigurationError(
                path, f"services.{service.name}.config.instance", f"another service has the name {instance!r}"
            )
    return ResolvedFacility(path, file, state, services)


def _resolve(path: Path, file: FacilityFile, name: str, service: FacilityService) -> ResolvedService:
    place: Path | None = None
    if isinstance(service.config, Path):
        place = path.parent / service.config
        document = read_document(place)
    else:
        document = dict(service.config)
    model = _model(path, name, service)
    if "instance" in model.model_fields:
        document.setdefault("instance", name)
    if service.verb == "router":
        document.setdefault("listen", file.bus.connect)
    else:
        _fill_bus(document, file)
    checked = check(model, document, source=place or f"{path}: services.{name}.config")
    return ResolvedService(name, service, checked)


def _fill_bus(document: dict[str, Any], file: FacilityFile) -> None:
    own = document.setdefault("bus", {})
    if isinstance(own, dict):  # otherwise the check reports the error
        document["bus"] = file.bus.model_dump(exclude_unset=True) | {"wait": True} | own


def _model(path: Path, name: str, service: FacilityService) -> type[BaseModel]:
    if service.driver is None:
        return _MODELS[service.verb]
    from rpod_driver.registered import adapter  # noqa: PLC0415 - not every facility has a driver

    try:
        return adapter(service.driver).config
    except SchemaError as error:
        raise ConfigurationError(path, f"services.{name}.driver", str(error)) from error
