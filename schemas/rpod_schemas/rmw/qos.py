"""Quality of service of ROS 2 endpoints, as rmw_zenoh writes it into liveliness tokens.

It is no part of a key, and Zenoh delivers whatever the two sides say. But ROS 2 tools read it from the
tokens: they call a subscriber that asks for more than a publisher offers incompatible.
"""

from dataclasses import dataclass
from typing import Self

_RELIABLE, _BEST_EFFORT = "1", "2"
_TRANSIENT_LOCAL, _VOLATILE = "1", "2"
_KEEP_ALL = "2"
_DEFAULT_DEPTH = 42
"""Values of rmw/types.h, and the depth of rmw_zenoh, which leaves each default out of a token."""


@dataclass(frozen=True)
class Qos:
    """Quality of service that a publisher or a service offers, or that a subscriber asks for."""

    reliable: bool = True
    transient_local: bool = False
    """Whether a subscriber that starts later gets earlier messages."""
    depth: int = 10
    """Number of messages that are kept; 0 for all."""
    lifespan_s: int = 0
    """Time after which a message is no longer kept for later subscribers, s; 0 for no limit."""

    def token(self) -> str:
        """Return it as rmw_zenoh writes it: ``<reliability>:<durability>:<history>,<depth>:...``."""
        reliability = "" if self.reliable else _BEST_EFFORT
        durability = _TRANSIENT_LOCAL if self.transient_local else ""
        history = f",{self.depth}" if self.depth else f"{_KEEP_ALL},"
        lifespan = f"{self.lifespan_s},0" if self.lifespan_s else ","
        return f"{reliability}:{durability}:{history}:,:{lifespan}:,,"

    @classmethod
    def read(cls, token: str) -> Self:
        """Read it from the last part of a token.

        Raises:
            ValueError: it is not of this form.
        """
        parts = token.split(":")
        if len(parts) < 6:
            raise ValueError(f"{token!r} is no quality of service of rmw_zenoh")
        reliability, durability, history, _, lifespan, *_ = parts
        kind, _, depth = history.partition(",")
        return cls(
            reliable=reliability in ("", _RELIABLE),
            transient_local=durability == _TRANSIENT_LOCAL,
            depth=0 if kind == _KEEP_ALL else int(depth or _DEFAULT_DEPTH),
            lifespan_s=int(lifespan.partition(",")[0] or 0),
        )

    def lacks(self, asked: "Qos") -> list[str]:
        """Return what a subscriber asks for and this offer lacks, by ROS's rules; empty where they match."""
        wanted = (
            ("RELIABLE", asked.reliable and not self.reliable),
            ("TRANSIENT_LOCAL", asked.transient_local and not self.transient_local),
        )
        return [name for name, missing in wanted if missing]


SERVICE = Qos()
"""rmw_qos_profile_services_default."""
LATCHED = Qos(transient_local=True, depth=1)
ROSOUT = Qos(transient_local=True, depth=1000, lifespan_s=10)
"""rcl_qos_profile_rosout_default."""
PARAMETERS = Qos(depth=1000)
"""rmw_qos_profile_parameters and rmw_qos_profile_parameter_events."""
ANY_PUBLISHER = Qos(reliable=False)
"""Quality of service of a subscriber that takes any publisher, best effort or reliable (REP 2003)."""
