"""The live view: what it draws, how often, and where it is seen."""

from ipaddress import IPv4Address
from pathlib import Path
from typing import Annotated, Literal
from urllib.parse import quote

from pydantic import Field, IPvAnyAddress

from rpod_schemas.config.base import Name
from rpod_schemas.config.service import ServiceConfig

MAX_RATE_HZ = 10.0
Port = Annotated[int, Field(ge=0, le=65535)]


class ViewConfig(ServiceConfig):
    """The live view."""

    instance: Name = "view"
    """Name on the bus."""
    target: str | None = None
    """Name or file of the target; left out, neither its mesh nor its wireframe is drawn."""
    prefix: Name = "estimate"
    """First part of the topics of the estimates that are shown."""
    truth: Literal["odometry", "tf"] = "odometry"
    """Where the truth is read: its own topic, or the transforms, which are fewer."""
    rate_hz: float = Field(default=MAX_RATE_HZ, gt=0, le=MAX_RATE_HZ)
    """Most frames of each sensor that are drawn in a second."""
    viewer: Literal["native", "web"] | None = None
    """A window or a web page; left out, a window where there is a display."""
    bind: IPvAnyAddress = IPv4Address("127.0.0.1")
    """Address at which the viewer can be reached."""
    port: Port = 0
    """Of the data; a free one where it is 0."""
    web_port: Port = 0
    """Of the web page; a free one where it is 0."""
    memory_bytes: int = Field(default=500_000_000, ge=50_000_000)
    """What the viewer keeps; the oldest is dropped."""
    save: Path | None = None
    """A recording (.rrd) to write instead of opening a viewer."""

    @property
    def data_url(self) -> str:
        """Where the viewer takes data."""
        return f"rerun+http://{self._host}:{self.port}/proxy"

    @property
    def page_url(self) -> str:
        """The web viewer's page."""
        return f"http://{self._host}:{self.web_port}/?url={quote(self.data_url, safe='')}"

    @property
    def _host(self) -> str:
        address = self.bind
        if address.is_unspecified:
            return "127.0.0.1" if address.version == 4 else "[::1]"
        return str(address) if address.version == 4 else f"[{address}]"
