"""The faults that were asked for, and the condition of each link at a time."""

from dataclasses import dataclass, field
from threading import Lock

from rpod_proxy.condition import Condition, condition_of
from rpod_runtime.errors import RefusedError
from rpod_schemas.control import FaultRequest
from rpod_schemas.faults.injected import InjectedFault
from rpod_schemas.messages import NANOSECONDS

_MOST_FAULTS = 500
"""Largest number of faults that wait or are active: a request is remembered until its fault is over."""


@dataclass
class Plan:
    """Faults with their times. Safe to use from several threads."""

    links: tuple[str, ...]
    """Names of the links."""
    _faults: list[InjectedFault] = field(default_factory=list)
    _lock: Lock = field(default_factory=Lock)

    def request(self, request: FaultRequest, now_ns: int) -> None:
        """Plan a fault. Raises ``RefusedError``."""
        if request.kind.subject != "link":
            raise RefusedError(f"{request.fault} is no fault of a link; the proxy injects link_...")
        if request.service not in self.links:
            raise RefusedError(
                f"the link of {request.service} does not pass through this proxy; {', '.join(self.links)} do"
            )
        begin_ns = now_ns + round(request.start_s * NANOSECONDS)
        end_ns = begin_ns + round(request.duration_s * NANOSECONDS)
        with self._lock:
            self._faults = [fault for fault in self._faults if fault.end_ns is None or fault.end_ns > now_ns]
            if len(self._faults) >= _MOST_FAULTS:
                raise RefusedError(f"{_MOST_FAULTS} faults are planned or active already; wait for their end")
            self._faults.append(
                InjectedFault(
                    request.fault, request.where, begin_ns, end_ns, request.kind.amount(request.size)
                )
            )

    def active(self, now_ns: int) -> list[InjectedFault]:
        """Return the faults that are active now, in the order of their beginning."""
        with self._lock:
            faults = [each for each in self._faults if each.begin_ns <= now_ns < (each.end_ns or 0)]
        return sorted(faults, key=lambda fault: fault.begin_ns)

    def condition(self, link: str, now_ns: int) -> Condition:
        """Return the condition of a link."""
        mine = (fault for fault in self.active(now_ns) if fault.where == link)
        return condition_of((fault.fault, fault.size) for fault in mine)
