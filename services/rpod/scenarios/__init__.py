"""The scenarios that are shipped with rpod, and the search for a scenario by name or file."""

from importlib import resources
from pathlib import Path

from rpod_schemas.config.base import load
from rpod_schemas.config.scenario import Scenario
from rpod_schemas.errors import ConfigurationError

DEFAULT = "mockup-tumbling"


def shipped() -> dict[str, Path]:
    """Return the files of the shipped scenarios, by name."""
    folder = Path(str(resources.files("rpod.scenarios")))
    return {file.stem: file for file in sorted(folder.glob("*.yaml"))}


def find(name: str) -> Scenario:
    """Return a shipped scenario by its name, or the scenario in a YAML or TOML file.

    Raises:
        ConfigurationError: the scenario does not exist, or it is wrong.
    """
    files = shipped()
    if name in files:
        return load(Scenario, files[name])
    if Path(name).suffix in (".yaml", ".yml", ".toml", ".json"):
        return load(Scenario, Path(name))
    raise ConfigurationError("scenario", name, f"not known; known are {', '.join(files)}, or give a file")
