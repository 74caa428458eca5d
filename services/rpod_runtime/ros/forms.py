"""How a query of the control plane is called as a ROS 2 service."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Generic, TypeVar

from pydantic import BaseModel

from rpod_schemas.control import ResetRequest
from rpod_schemas.messages.ros import read_reset
from rpod_schemas.rmw.cdr import message_class
from rpod_schemas.rmw.service_types import RESET, TRIGGER

RequestT = TypeVar("RequestT", bound=BaseModel)


@dataclass(frozen=True)
class Form(Generic[RequestT]):
    """A service type whose response has ``success`` and ``message``, and the query's request of a call."""

    type: str
    request: Callable[[Any], RequestT]

    def accepted(self, reply: BaseModel) -> Any:
        """Return the response with the reply of the query as JSON."""
        return self._response(success=True, message=reply.model_dump_json())

    def refused(self, reason: str) -> Any:
        """Return the response that says why the query was refused."""
        return self._response(success=False, message=reason)

    @property
    def _response(self) -> Callable[..., Any]:
        return partial(message_class(f"{self.type}_Response"))


def trigger(request: Callable[[], RequestT]) -> Form[RequestT]:
    """Return the form of a std_srvs/Trigger; ``request`` returns the query's request of such a call."""
    return Form(TRIGGER, lambda _: request())


RESET_SERVICE: Form[ResetRequest] = Form(RESET, read_reset)
"""rpod_msgs/ResetEstimator: a reset with an optional pose."""
