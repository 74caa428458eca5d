"""Features of a GenICam camera by the names of the Standard Features Naming Convention (SFNC 2.7)."""

from collections.abc import Mapping
from typing import Any

from rpod_driver.errors import DriverError


class FeatureError(DriverError):
    """A feature of a camera is missing, or does not take a value."""


def write(nodes: Any, name: str, value: Any) -> None:
    """Write a feature. Raises ``FeatureError``."""
    if not nodes.has_node(name):
        raise FeatureError(f"the camera has no feature {name!r}; look its name up in the camera's manual")
    try:
        getattr(nodes, name).value = _symbolic(getattr(nodes, name), value)
    except Exception as error:  # genicam raises classes of compiled code without a common base
        limits = _limits(getattr(nodes, name))
        raise FeatureError(f"the camera refuses {name} = {value!r}{limits}: {_first_line(error)}") from error


def _symbolic(node: Any, value: Any) -> Any:
    """Return On or Off for a truth value of an enumeration: YAML reads ``ExposureAuto: Off`` as false."""
    word = "On" if value else "Off"
    return word if isinstance(value, bool) and word in _symbolics(node) else value


def offers(nodes: Any, name: str, value: str) -> bool:
    """Return whether the camera has an enumeration that takes a value."""
    return bool(nodes.has_node(name)) and value in _symbolics(getattr(nodes, name))


def _symbolics(node: Any) -> tuple[str, ...]:
    """Return the values that an enumeration takes now; none of another feature."""
    try:
        return tuple(map(str, node.symbolics))
    except Exception:  # noqa: BLE001 - not available now: a class of compiled code without a common base
        return ()


def write_all(nodes: Any, settings: Mapping[str, Any]) -> None:
    """Write features in their order, or none of them. Raises ``FeatureError``."""
    before: list[tuple[str, Any]] = []
    try:
        for name, value in settings.items():
            was = read(nodes, name)
            write(nodes, name, value)
            before.append((name, was))
    except FeatureError:
        for name, was in reversed(before):
            if was is not None:
                write(nodes, name, was)
        raise


def execute(nodes: Any, name: str) -> None:
    """Execute a command. Raises ``FeatureError``."""
    if not nodes.has_node(name):
        raise FeatureError(
            f"the camera has no command {name!r}, so it takes no frame on request; set device.trigger "
            "to none or hardware"
        )
    try:
        getattr(nodes, name).execute()
    except Exception as error:  # genicam raises classes of compiled code without a common base
        raise FeatureError(
            f"the camera does not execute {name}: {_first_line(error)}; check its trigger settings"
        ) from error


def read(nodes: Any, name: str) -> Any:
    """Return a feature's value, None if the camera has none, or none now."""
    try:
        return getattr(nodes, name).value if nodes.has_node(name) else None
    except Exception:  # noqa: BLE001 - a feature that is not available now raises a class of compiled code
        return None


def _limits(node: Any) -> str:
    try:
        if hasattr(node, "symbolics"):
            return f", it takes {', '.join(map(str, node.symbolics))}"
        return f", it takes {node.min:g} to {node.max:g}"
    except Exception:  # noqa: BLE001 - limits of a feature that is not available
        return ""


def _first_line(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]
