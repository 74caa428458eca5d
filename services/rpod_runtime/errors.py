"""The errors of the bus."""

from rpod_schemas.errors import RpodError


class BusError(RpodError):
    """Root of the errors that this package raises."""


class NoRouterError(BusError):
    """Nobody answers at the router's endpoint."""

    def __init__(self, endpoint: str, waited_s: float, identity: str | None = None) -> None:
        taken = f", end the other client that holds the identity {identity}" if identity else ""
        super().__init__(
            f"no router at {endpoint} after {waited_s:.0f} s; start one with 'rpod router', "
            f"name another with --connect{taken}, or let this service wait with --wait"
        )


class EndpointError(BusError):
    """The router cannot listen where it was told to."""

    def __init__(self, endpoint: str, reason: str) -> None:
        super().__init__(f"cannot listen on {endpoint}: {reason}; is another router running there?")


class QueryFailedError(BusError):
    """A control-plane query was not answered, or was answered with an error."""

    def __init__(self, key: str, reason: str) -> None:
        super().__init__(f"{key}: {reason}")


class LockstepError(BusError):
    """A service did not keep up with lockstep in time."""

    def __init__(self, service: str, waited_for: str, waited_s: float) -> None:
        self.service = service
        super().__init__(f"{service} did not deliver {waited_for} within {waited_s:.0f} s of lockstep")


class ExtrinsicsError(BusError):
    """A sensor's mount is unknown, or told in two ways."""


class RefusedError(BusError):
    """A command that cannot be carried out now; says why and what to do instead."""
