"""The targets of the trials, loaded once per process by name, or provided by the client."""

from collections.abc import Mapping

from rpod_schemas.errors import ConfigurationError
from rpod_target import Target, TargetError, check_model, load_target
from rpod_target.variation import SIGN

_TARGETS: dict[str, Target] = {}


def cached_target(name: str) -> Target:
    """Return a target, which is loaded once per process. Raises TargetError."""
    if name not in _TARGETS:
        _TARGETS[name] = load_target(name)
    return _TARGETS[name]


def model_of(target: str, model: str | None) -> str:
    """Return the name of the model of a target; empty if it is the target itself.

    Args:
        target: name of the target.
        model: name of its model, or the terms of a variation of it; None for the target itself.

    Raises:
        ConfigurationError: the model cannot be loaded, or has other axes.
    """
    if model is None:
        return ""
    name = target + model if model.startswith(SIGN) else model
    try:
        check_model(cached_target(target), cached_target(name))
    except ConfigurationError as error:
        raise ConfigurationError("--model", "", str(error)) from error
    return name


def provide_targets(targets: Mapping[str, Target]) -> None:
    """Store targets, by name, whose files are on another machine."""
    _TARGETS.update(targets)


def missing_targets(digests: Mapping[str, str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the targets that this process cannot load, and those that it used in another form, by name.

    Args:
        digests: digests of the needed targets, by name.
    """
    unknown, other = [], []
    for name, digest in digests.items():
        known = name in _TARGETS
        try:
            found = cached_target(name).digest
        except TargetError:
            unknown.append(name)
            continue
        if found == digest:
            continue
        if known:  # trials of this process may have built on it
            other.append(name)
        else:
            del _TARGETS[name]
            unknown.append(name)
    return tuple(unknown), tuple(other)
