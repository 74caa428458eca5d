"""Hostile calls of ROS 2 services: a reset, and parameters that are set."""

from collections.abc import Callable, Iterator
from functools import cache, partial
from random import Random
from typing import Any

import numpy as np
from fuzz.mutation import mutate_message

from rpod_runtime.errors import RefusedError
from rpod_runtime.ros.parameters import Parameters
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.messages import write_pose_stamped
from rpod_schemas.messages.ros import read_parameter_value, read_reset, write_parameter
from rpod_schemas.poses import make_pose
from rpod_schemas.rmw.cdr import decode, encode, message_class
from rpod_schemas.rmw.service_types import RESET, SET_PARAMETERS
from rpod_schemas.topics import CHASER, TARGET
from rpod_schemas.types import Odometry

_RESET, _SET = f"{RESET}_Request", f"{SET_PARAMETERS}_Request"


def call_subjects() -> Iterator[tuple[str, Callable[[Random], bytes], Callable[[bytes], bool]]]:
    """Yield name, maker and reader of what reads calls."""
    for name, type_name, read in (("reset", _RESET, _take_reset), ("set_parameters", _SET, _take_parameters)):
        yield f"call {name}", partial(_make, type_name), partial(_read, type_name, read)


@cache
def _seed(type_name: str) -> bytes:
    if type_name == _SET:
        values = (True, 3, 2.5, "text", [1, 2], [0.5], ["a"])
        named = [write_parameter(f"p{number}", value) for number, value in enumerate(values)]
        return bytes(encode(message_class(_SET)(parameters=named)))
    target = Odometry(
        stamp_ns=1,
        frame_id=CHASER,
        child_frame_id=TARGET,
        pose=make_pose(translation_m=(0.0, 0.0, 4.0)),
        linear_m_s=np.zeros(3),
        angular_rad_s=np.zeros(3),
        pose_covariance=np.eye(6),
    )
    pose = write_pose_stamped(target)
    return bytes(encode(message_class(_RESET)(with_pose=True, pose=pose, keep_gid="0" * 32)))


def _make(type_name: str, rnd: Random) -> bytes:
    return mutate_message(rnd, _seed(type_name), type_name)


def _read(type_name: str, take: Callable[[Any], bool], payload: bytes) -> bool:
    try:
        return take(decode(payload, type_name))
    except MessageRejectedError:
        return False


def _take_reset(message: Any) -> bool:
    read_reset(message).model_dump_json()
    return True


def _take_parameters(message: Any) -> bool:
    parameters, taken = Parameters({}), False
    for number, value in enumerate((True, 3, 2.5, "text", [1, 2], [0.5], ["a"])):
        parameters.offer(f"p{number}", value, lambda _: None)
    for each in message.parameters:
        try:
            parameters.set([(each.name, read_parameter_value(each.value))])
            taken = True
        except RefusedError:
            continue
    return taken
