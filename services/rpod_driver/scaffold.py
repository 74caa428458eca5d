"""Writes the package of a new driver from a template; the package runs before anything in it is changed."""

import re
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from string import Template

from rpod_driver.errors import DriverError

TEMPLATES = {"custom": "pmd", "ifm": "pmd", "ros": "pmd"}
"""Kind of the sensor of each template."""
_SETTINGS = {
    "custom": """\
# What the driver writes to the device after each connection.
# settings: {exposure_us: 4000}""",
    "ifm": """\
# Address of the head; without it a simulated one.
# settings: {ip: 192.168.0.69, port: port2}""",
    "ros": """\
# Router of the ROS graph, and topics there; without them a simulated camera.
# settings:
#   connect: tcp/127.0.0.1:7448
#   depth: camera/depth/image_rect_raw
#   camera_info: camera/depth/camera_info""",
}
"""Example of the settings in the configuration of each template."""
_NAME = re.compile(r"[a-z][a-z0-9_]*")
_ENDING = ".tmpl"


class ScaffoldError(DriverError):
    """A package cannot be written."""


def scaffold(template: str, name: str, out: Path) -> Path:
    """Write a package and return its folder.

    Args:
        template: ``custom``, ``ifm`` or ``ros``.
        name: name of the package, as ``my_camera``.
        out: folder in which the package's folder is made.

    Raises:
        ScaffoldError: unknown template, a name that is no package's, or the folder is there already.
        OSError: the folder cannot be written.
    """
    if template not in TEMPLATES:
        raise ScaffoldError(f"template is {template!r}; known are {', '.join(TEMPLATES)}")
    if not _NAME.fullmatch(name):
        raise ScaffoldError(f"name is {name!r}; use small letters, digits and underscores, as my_camera")
    folder = out / name
    if folder.exists():
        raise ScaffoldError(f"{folder} exists already; choose another name or --out")
    words = {
        "name": name,
        "Class": "".join(part.capitalize() for part in name.split("_")),
        "kind": TEMPLATES[template],
        "settings": _SETTINGS[template],
    }
    root = files("rpod_driver") / "templates"
    for source in (root / "shared", root / template):
        for file, relative in _files(source, Path()):
            place = folder / Template(str(relative).removesuffix(_ENDING)).substitute(words)
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_text(Template(file.read_text("utf-8")).substitute(words), "utf-8")
    return folder


def _files(folder: Traversable, relative: Path) -> list[tuple[Traversable, Path]]:
    """Return the files of a folder of templates, with their places in it."""
    found: list[tuple[Traversable, Path]] = []
    for each in folder.iterdir():
        if each.is_dir():
            found += _files(each, relative / each.name)
        elif each.name.endswith(_ENDING):
            found.append((each, relative / each.name))
    return found
