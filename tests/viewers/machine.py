"""Which readers and viewers this machine has, in which versions, and what the others lack."""

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

HERE = Path(__file__).parent
PACKAGES = HERE / "node_modules"
VULKAN_DRIVERS = Path("/usr/share/vulkan/icd.d")
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
NODE_AT_LEAST = 20


@dataclass(frozen=True)
class Tool:
    """A reader or a viewer with all that it needs."""

    name: str
    """With versions, where it is there."""
    missing: str = ""
    """What it lacks; empty where it is ready."""


@cache
def tool(key: str) -> Tool:
    """Return one of ``TOOLS`` as this machine has it."""
    return TOOLS[key]()


def browser() -> str:
    """Return the program of Chromium; empty where there is none."""
    return next((found for name in BROWSERS if (found := shutil.which(name))), "")


def rerun_program() -> str:
    """Return Rerun's command, beside the interpreter or on the path; empty where there is none."""
    return shutil.which("rerun", path=str(Path(sys.executable).parent)) or shutil.which("rerun") or ""


def _rosbags() -> Tool:
    return Tool(f"rosbags {version('rosbags')}")


def _mcap_ros2() -> Tool:
    return Tool(f"mcap {version('mcap')} with mcap-ros2-support {version('mcap-ros2-support')}")


def _node() -> Tool:
    return _of_node("", "@mcap/core", "@foxglove/rosmsg2-serialization")


def _rerun() -> Tool:
    if not find_spec("rerun"):
        return Tool("Rerun", "rerun-sdk is not installed")
    return Tool(f"rerun-sdk {version('rerun-sdk')}")


def _rerun_viewer() -> Tool:
    rerun = tool("rerun")
    if not rerun.missing and not any(VULKAN_DRIVERS.glob("lvp_icd*.json")):
        return Tool("Rerun's viewer", "mesa-vulkan-drivers is not installed")
    return Tool("Rerun's viewer", rerun.missing)


def _chromium() -> Tool:
    if not browser():
        return Tool("Chromium", "chromium is not installed")
    return _of_node(_output(browser(), "--version"), "playwright-core")


def _of_node(name: str, *packages: str) -> Tool:
    """Return a tool that runs in Node.js with packages of ``package-lock.json``."""
    name = ", ".join(filter(None, (name, *packages)))
    if not shutil.which("node"):
        return Tool(name, "Node.js is not installed")
    node = _output("node", "--version")
    if int(node.lstrip("v").split(".")[0]) < NODE_AT_LEAST:
        return Tool(name, f"Node.js is {node}, {NODE_AT_LEAST} or later is needed")
    if any(not (PACKAGES / package).is_dir() for package in packages):
        return Tool(name, "the packages of tests/viewers/package-lock.json are not installed")
    found = {package: json.loads((PACKAGES / package / "package.json").read_text()) for package in packages}
    for package, description in found.items():
        name = name.replace(package, f"{package} {description['version']}")
    return Tool(f"{name}, Node.js {node}")


def _output(*command: str) -> str:
    done = subprocess.run(command, capture_output=True, text=True, timeout=60.0, check=False)
    return done.stdout.strip()


TOOLS: dict[str, Callable[[], Tool]] = {
    "rosbags": _rosbags,
    "mcap_ros2": _mcap_ros2,
    "node": _node,
    "rerun": _rerun,
    "rerun_viewer": _rerun_viewer,
    "chromium": _chromium,
}
