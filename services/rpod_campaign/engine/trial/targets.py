"""The targets of the trials: loaded once a process, by name, or provided by whoever started the campaign."""

from collections.abc import Mapping

from rpod_target import Target, TargetError, load_target

_TARGETS: dict[str, Target] = {}


def cached_target(name: str) -> Target:
    """Return a target, loaded once a process. Raises TargetError."""
    if name not in _TARGETS:
        _TARGETS[name] = load_target(name)
    return _TARGETS[name]


def provide_targets(targets: Mapping[str, Target]) -> None:
    """Let trials find targets, by name, whose files are on another machine."""
    _TARGETS.update(targets)


def missing_targets(digests: Mapping[str, str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the targets that this process cannot load, and those that it used in another form, by name.

    Args:
        digests: of the targets that are needed, by name.
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
