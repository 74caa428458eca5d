"""Errors that this package raises."""

from pathlib import Path

from rpod_schemas.errors import RpodError


class BusError(RpodError):
    """Root of the errors that this package raises."""


class NoRouterError(BusError):
    """No router answers at the endpoint."""

    def __init__(
        self, endpoint: str, waited_s: float, identity: str | None = None, *, stopped: bool = False
    ) -> None:
        if stopped:
            super().__init__(f"stopped after it had waited {waited_s:.0f} s for a router at {endpoint}")
            return
        taken = f", end the other client that holds the identity {identity}" if identity else ""
        super().__init__(
            f"no router at {endpoint} after {waited_s:.0f} s; start one with 'rpod router', "
            f"name another with --connect{taken}, or let this service wait with --wait"
        )


class AlreadyRunningError(BusError):
    """A service of this name is at work on the bus."""

    def __init__(self, instance: str, uptime_s: float) -> None:
        super().__init__(
            f"another {instance!r} is at work on this bus, for {uptime_s:.0f} s: two would answer the same "
            "queries and publish the same topics; stop it, or give this one another instance (an estimator: "
            "another prefix and zenoh_id, too)"
        )


class NotNeededError(BusError):
    """A process in reserve was stopped before its turn came."""

    def __init__(self) -> None:
        super().__init__("stopped in reserve")


class RefusedByRouterError(BusError):
    """A router listens at the endpoint and refuses this client."""

    def __init__(self, endpoint: str, reason: str) -> None:
        super().__init__(f"the router at {endpoint} refuses this client: {reason}")


class EndpointError(BusError):
    """The router cannot listen on its configured endpoint."""

    def __init__(self, endpoint: str, reason: str) -> None:
        taken = "in use" in reason
        remedy = (
            "is another router running there?" if taken else "is it an address of this machine, with a port?"
        )
        super().__init__(f"cannot listen on {endpoint}: {reason}; {remedy}")


class NotThisServiceError(BusError):
    """The credentials are of another name than the service's instance."""

    def __init__(self, instance: str, name: str, folder: Path) -> None:
        super().__init__(
            f"instance is {instance!r}, but bus.credentials ({folder}) are those of {name!r}; the router "
            f"identifies a service by its certificate: set instance to {name!r}, or issue a certificate for "
            f"{instance!r} with 'rpod pki issue'"
        )


class QueryFailedError(BusError):
    """A control-plane query was not answered, or was answered with an error."""

    def __init__(self, key: str, reason: str) -> None:
        super().__init__(f"{key}: {reason}")


class LockstepError(BusError):
    """A service did not deliver in time what lockstep waits for."""

    def __init__(self, service: str, waited_for: str, waited_s: float) -> None:
        self.service = service
        super().__init__(
            f"{service} did not deliver {waited_for} within {waited_s:.0f} s, so that lockstep cannot go on; "
            f"check the log lines of {service}"
        )


class ExtrinsicsError(BusError):
    """The mount of a sensor is unknown, or two sources give different ones."""


class RefusedError(BusError):
    """A command cannot be carried out now; the text gives the reason and the remedy."""
