"""A node in the ROS 2 graph, beside its topics: services, parameters, log lines."""

import json
import logging
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from typing import Any, Protocol

import zenoh

from rpod_runtime.delivery.publisher import Publisher
from rpod_runtime.ros.parameter_services import ParameterServices
from rpod_runtime.ros.parameters import Assignment, Parameters
from rpod_runtime.ros.rosout import RosoutHandler
from rpod_runtime.ros.server import Answer, Refuse, ServiceServer
from rpod_schemas.messages.ros import write_parameter, write_parameter_event
from rpod_schemas.rmw import qos
from rpod_schemas.rmw.wire import node_name
from rpod_schemas.topics import PARAMETER_EVENTS, ROSOUT, Namespace, Service, Topic

_LEVELS = ("debug", "info", "warning", "error")


class Owner(Protocol):
    """Node in the graph: it declares publishers and tokens that end with it."""

    def publisher(self, topic: Topic) -> Publisher:
        """Declare a publisher."""
        ...

    def show(self, service: Service) -> None:
        """Declare the token of a service."""
        ...

    def note_command(self, verb: str, request: str) -> None:
        """Keep an accepted command for the log."""
        ...


class RosGraph:
    """Services, parameters and log lines of a node; ``close`` ends them."""

    def __init__(self, owner: Owner, session: zenoh.Session, keys: Namespace, instance: str) -> None:
        self._owner, self._session, self._keys = owner, session, keys
        self._name = node_name(instance)
        self._stack = ExitStack()
        full_name = ".".join((*keys.prefix.split("/"), self._name)).lstrip(".")
        rosout = RosoutHandler(full_name, owner.publisher(ROSOUT).publish)
        self._stack.callback(rosout.close)

    def close(self) -> None:
        """Take all services off the bus."""
        self._stack.close()

    def serve(
        self, verb: str, type_name: str, *, answer: Answer, refuse: Refuse, offered: qos.Qos = qos.SERVICE
    ) -> None:
        """Answer a service under the node's name: ``/<namespace>/<node>/<verb>``."""
        service = Service(f"{self._name}/{verb}", type_name, offered)
        server = ServiceServer(self._session, self._keys, service, answer=answer, refuse=refuse)
        self._stack.callback(server.close)
        self._owner.show(service)

    def serve_parameters(self, document: Mapping[str, Any], *, use_sim_time: bool) -> Parameters:
        """Answer the parameter services for a configuration; return the parameters."""
        parameters = Parameters(document)
        parameters.offer("use_sim_time", use_sim_time, description="whether time is the topic clock")
        _offer_log_level(parameters)
        publish = self._owner.publisher(PARAMETER_EVENTS).publish
        node = self._keys.ros_name(Service(self._name, ""))

        def tell(changes: Sequence[Assignment]) -> None:
            changed = [write_parameter(*each) for each in changes]
            publish(write_parameter_event(time.time_ns(), node, changed=changed))
            self._owner.note_command("set_parameters", json.dumps(dict(changes), default=str))

        parameters.on_change(tell)
        for each in ParameterServices(parameters).all():
            self.serve(each.name, each.type, answer=each.answer, refuse=each.refuse, offered=qos.PARAMETERS)
        new = [write_parameter(name, parameters.value(name)) for name in parameters.names()]
        publish(write_parameter_event(time.time_ns(), node, new=new))
        return parameters


def _offer_log_level(parameters: Parameters) -> None:
    root = logging.getLogger()

    def change(level: str) -> None:
        if level not in _LEVELS:
            raise ValueError(f"is one of {', '.join(_LEVELS)}, not {level!r}")
        root.setLevel(level.upper())

    parameters.offer(
        "log_level",
        logging.getLevelName(root.level).lower(),
        change,
        description="least level of the log lines on standard error and /rosout",
        constraints=f"one of {', '.join(_LEVELS)}",
    )
