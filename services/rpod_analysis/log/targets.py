"""The targets of a run, by the configurations in its log."""

from typing import Any, NamedTuple

from rpod_analysis.log.log import Log
from rpod_schemas.config.estimator import EstimatorConfig

_ESTIMATOR = EstimatorConfig.model_fields["instance"].default
_PREFIX = EstimatorConfig.model_fields["prefix"].default


class LoggedTargets(NamedTuple):
    """Names or files of a run's targets; None where no configuration in the log names one."""

    truth: str | None
    """Target that moved and that was emulated."""
    model: str | None
    """Target that the estimator looked for."""

    @property
    def shown(self) -> str | None:
        """The truth if it is named, otherwise the model."""
        return self.truth or self.model


def logged_targets(log: Log, *, prefix: str = _PREFIX) -> LoggedTargets:
    """Return the targets of a run; of several estimators, of that whose topics begin with a prefix."""
    named = {name: service for name, service in log.configuration.items() if service.get("target")}
    models = {name: service for name, service in named.items() if _estimates(name, service)}
    truths = [service["target"] for name, service in named.items() if name not in models]
    chosen = [service for service in models.values() if service.get("prefix") == prefix]
    model = next(iter([*chosen, *models.values()]), {})
    return LoggedTargets(next(iter(truths), None), model.get("target"))


def _estimates(name: str, service: dict[str, Any]) -> bool:
    return name == _ESTIMATOR or {"prefix", "sensors"} <= service.keys()
