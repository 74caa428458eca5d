"""The six parameter services of a ROS 2 node, and ``/parameter_events``.

A client of parameters in ROS 2 is ready only where all six are there.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rpod_runtime.errors import RefusedError
from rpod_runtime.ros.parameters import Parameters
from rpod_schemas.messages.ros import parameter_type, read_parameter_value, write_parameter_value
from rpod_schemas.rmw import service_types as types
from rpod_schemas.rmw.cdr import message_class


@dataclass(frozen=True)
class ParameterService:
    """One of the six: its name, its type, and its response to a request, or to one that cannot be read."""

    name: str
    type: str
    answer: Callable[[Any], Any]
    refuse: Callable[[str], Any]


class ParameterServices:
    """Answers the requests for a node's parameters."""

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters

    def all(self) -> Iterator[ParameterService]:
        """Yield the services."""
        yield ParameterService(
            "get_parameters",
            types.GET_PARAMETERS,
            self._get,
            lambda _: _response(types.GET_PARAMETERS, values=[]),
        )
        yield ParameterService(
            "get_parameter_types",
            types.GET_PARAMETER_TYPES,
            self._get_types,
            lambda _: _response(types.GET_PARAMETER_TYPES, types=np.empty(0, np.uint8)),
        )
        yield ParameterService(
            "list_parameters", types.LIST_PARAMETERS, self._list, lambda _: _listed([], [])
        )
        yield ParameterService(
            "describe_parameters",
            types.DESCRIBE_PARAMETERS,
            self._describe,
            lambda _: _response(types.DESCRIBE_PARAMETERS, descriptors=[]),
        )
        yield ParameterService(
            "set_parameters",
            types.SET_PARAMETERS,
            self._set,
            lambda reason: _response(types.SET_PARAMETERS, results=[_result(reason)]),
        )
        yield ParameterService(
            "set_parameters_atomically",
            types.SET_PARAMETERS_ATOMICALLY,
            self._set_together,
            lambda reason: _response(types.SET_PARAMETERS_ATOMICALLY, result=_result(reason)),
        )

    def _get(self, request: Any) -> Any:
        values = [write_parameter_value(self._parameters.value(name)) for name in request.names]
        return _response(types.GET_PARAMETERS, values=values)

    def _get_types(self, request: Any) -> Any:
        numbers = [parameter_type(self._parameters.value(name)) for name in request.names]
        return _response(types.GET_PARAMETER_TYPES, types=np.array(numbers, np.uint8))

    def _list(self, request: Any) -> Any:
        return _listed(*self._parameters.listed(request.prefixes, int(request.depth)))

    def _describe(self, request: Any) -> Any:
        descriptors = [self._descriptor(name) for name in request.names]
        return _response(types.DESCRIBE_PARAMETERS, descriptors=descriptors)

    def _descriptor(self, name: str) -> Any:
        item = self._parameters.get(name)
        return message_class("rcl_interfaces/msg/ParameterDescriptor")(
            name=name,
            type=parameter_type(item.value) if item else 0,
            description=item.description if item else "",
            additional_constraints=item.constraints if item else "",
            read_only=item is not None and item.change is None,
            dynamic_typing=False,
            floating_point_range=[],
            integer_range=[],
        )

    def _set(self, request: Any) -> Any:
        results = [self._outcome([parameter]) for parameter in request.parameters]
        return _response(types.SET_PARAMETERS, results=results)

    def _set_together(self, request: Any) -> Any:
        return _response(types.SET_PARAMETERS_ATOMICALLY, result=self._outcome(request.parameters))

    def _outcome(self, parameters: Sequence[Any]) -> Any:
        try:
            self._parameters.set([(each.name, read_parameter_value(each.value)) for each in parameters])
        except RefusedError as error:
            return _result(str(error))
        return _result("")


def _response(type_name: str, **fields: Any) -> Any:
    return message_class(f"{type_name}_Response")(**fields)


def _listed(names: Sequence[str], prefixes: Sequence[str]) -> Any:
    result = message_class("rcl_interfaces/msg/ListParametersResult")(names=names, prefixes=prefixes)
    return _response(types.LIST_PARAMETERS, result=result)


def _result(reason: str) -> Any:
    return message_class("rcl_interfaces/msg/SetParametersResult")(successful=not reason, reason=reason)
