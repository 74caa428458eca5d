"""The scenarios that are shipped with rpod, and the search for a scenario by name or file."""

from difflib import get_close_matches
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
    meant = get_close_matches(name, files, n=1)
    guess = f" (did you mean {meant[0]}?)" if meant else ""
    raise ConfigurationError(
        "scenario", name, f"is not known{guess}; give one of {', '.join(files)}, or the path of a YAML file"
    )
