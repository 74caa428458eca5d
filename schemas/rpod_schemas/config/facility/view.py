"""Configuration of the live view: its contents, its rate, and its address."""

from ipaddress import IPv4Address
from pathlib import Path
from typing import Annotated, Literal, Self
from urllib.parse import quote

from pydantic import Field, IPvAnyAddress, field_validator, model_validator

from rpod_schemas.config.base import Name
from rpod_schemas.config.service import ServiceConfig

MAX_RATE_HZ = 10.0
RECORDING = ".rrd"
"""Ending of a recording of the viewer."""
Port = Annotated[int, Field(ge=0, le=65535)]


class ViewConfig(ServiceConfig):
    """Configuration of the live view."""

    instance: Name = "view"
    """Name on the bus."""
    target: str | None = None
    """Name or file of the target; if left out, neither its mesh nor its wireframe is drawn."""
    prefix: Name = "estimate"
    """First part of the topics of the estimates that are shown."""
    truth: Literal["odometry", "tf"] = "odometry"
    """Source of the truth: its own topic, or the transforms, of which there are fewer."""
    rate_hz: float = Field(default=MAX_RATE_HZ, gt=0, le=MAX_RATE_HZ)
    """Largest number of frames of each sensor that are drawn per second."""
    viewer: Literal["native", "web"] | None = None
    """Viewer: a window or a web page; if left out, a window if there is a display."""
    bind: IPvAnyAddress = IPv4Address("127.0.0.1")
    """Address at which the viewer can be reached; one of the network needs ``token_file``."""
    token_file: Path | None = None
    """File with the token that a browser has to give, where ``bind`` is an address of the network; made,
    readable by its owner alone, if it is not there."""
    port: Port = 0
    """Port of the data; a free one if 0."""
    web_port: Port = 0
    """Port of the web page; a free one if 0."""
    memory_bytes: int = Field(default=500_000_000, ge=50_000_000)
    """Largest memory of the viewer, bytes; beyond it the oldest data are dropped."""
    save: Path | None = None
    """Path of a recording (.rrd) that is written instead of a view."""

    @field_validator("save")
    @classmethod
    def _viewers_know_a_recording_by_its_ending(cls, path: Path | None) -> Path | None:
        if path is not None and path.suffix != RECORDING:
            raise ValueError(
                f"is {str(path)!r}; it is written in the format of the viewer Rerun, which opens a file by "
                f"its ending: take {str(path.with_suffix(RECORDING))!r}"
            )
        return path

    @model_validator(mode="after")
    def _a_secure_bus_is_shown_here_alone(self) -> Self:
        if self.bus.credentials is not None and not self.bind.is_loopback:
            raise ValueError(
                f"bind is {self.bind}, but the viewer has no login, and a secure bus keeps its data "
                "from strangers: leave bind out, and reach the viewer by an SSH tunnel"
            )
        return self

    @model_validator(mode="after")
    def _the_network_needs_a_token(self) -> Self:
        if self.bind.is_loopback:
            return self
        if self.token_file is None:
            raise ValueError(
                f"bind is {self.bind}, where others can reach the viewer: give token_file (--token-file), or "
                "leave bind out and reach the viewer by an SSH tunnel"
            )
        if self.viewer == "native":
            raise ValueError(
                f"bind is {self.bind}, but a window needs no address: leave bind out, or use web"
            )
        return self

    @property
    def is_open(self) -> bool:
        """Whether other machines can reach the viewer, by its token."""
        return not self.bind.is_loopback

    @property
    def data_url(self) -> str:
        """URL to which data are sent."""
        return f"rerun+http://{self._host}:{self.port}/proxy"

    @property
    def page_url(self) -> str:
        """URL of the web viewer's page."""
        return f"http://{self._host}:{self.web_port}/?url={quote(self.data_url, safe='')}"

    @property
    def _host(self) -> str:
        address = self.bind
        if address.is_unspecified:
            return "127.0.0.1" if address.version == 4 else "[::1]"
        return str(address) if address.version == 4 else f"[{address}]"
