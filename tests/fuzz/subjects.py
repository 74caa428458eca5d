"""What is fuzzed in this process: how a hostile input is made, and what may be raised of it."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml
from fuzz import pictures
from fuzz.calls import call_subjects
from fuzz.devices import device_subjects
from fuzz.logs import log_subjects
from fuzz.meshes import mesh_subjects
from fuzz.mutation import json_of, mutate_bytes, mutate_document, mutate_message
from fuzz.records import record_subjects
from fuzz.seeds import TOPICS, messages
from pydantic import BaseModel, ValidationError

from rpod_estimator.frame_reader import FrameReader
from rpod_logger.publisher_ends import PublisherEnds
from rpod_runtime import Received
from rpod_runtime.bus.link import Link
from rpod_runtime.delivery.accounting import DuplicateError, JumpError, SequenceAccount
from rpod_runtime.frames import PartRejectedError
from rpod_runtime.health import HealthBook
from rpod_schemas import control
from rpod_schemas.config.base import load
from rpod_schemas.config.emulator import EmulatorConfig, MotionServiceConfig
from rpod_schemas.config.estimator import EstimatorConfig, LidarInput, PmdInput
from rpod_schemas.config.facility.logger import LoggerConfig
from rpod_schemas.config.scenario import Scenario
from rpod_schemas.config.service import RouterConfig
from rpod_schemas.errors import ConfigurationError, MessageRejectedError
from rpod_schemas.faults.injected import read_faults
from rpod_schemas.messages import (
    read_amplitude,
    read_camera,
    read_command,
    read_depth,
    read_diagnostics,
    read_image,
    read_imu,
    read_integrity,
    read_joints,
    read_lidar_info,
    read_odometry,
    read_pmd_info,
    read_points,
    read_status,
    read_transforms,
    read_validity,
    read_vector_stamped,
)
from rpod_schemas.rmw.cdr import decode, peek_stamp
from rpod_schemas.rmw.wire import (
    EVERY_PUBLISHER,
    GID_BYTES,
    Attachment,
    GraphNode,
    session_of_token,
    topic_of_token,
    unpack_attachment,
)
from rpod_schemas.topics import DIAGNOSTICS, Namespace, Topic
from rpod_target import load_equivalence, shipped_targets

READERS: dict[str, tuple[Callable[[Any], Any], ...]] = {
    "sensor_msgs/msg/Image": (read_depth, read_amplitude, read_image),
    "sensor_msgs/msg/CameraInfo": (read_camera,),
    "sensor_msgs/msg/PointCloud2": (read_points,),
    "sensor_msgs/msg/JointState": (read_joints,),
    "sensor_msgs/msg/Imu": (read_imu,),
    "geometry_msgs/msg/AccelWithCovarianceStamped": (read_command,),
    "rpod_msgs/msg/Integrity": (read_integrity,),
    "rpod_msgs/msg/PmdInfo": (read_pmd_info,),
    "rpod_msgs/msg/LidarInfo": (read_lidar_info,),
    "rpod_msgs/msg/EstimatorStatus": (read_status,),
    "rpod_msgs/msg/EstimateValidity": (read_validity,),
    "tf2_msgs/msg/TFMessage": (read_transforms,),
    "nav_msgs/msg/Odometry": (read_odometry,),
    "geometry_msgs/msg/Vector3Stamped": (read_vector_stamped,),
    "diagnostic_msgs/msg/DiagnosticArray": (read_diagnostics, read_faults),
}
REQUESTS = (
    control.ResetRequest,
    control.StartRequest,
    control.LogRequest,
    control.FaultRequest,
    control.Empty,
)
_REQUEST_SEEDS: tuple[dict[str, Any], ...] = (
    {
        "pose": {"translation_m": [0, 0, 4], "quaternion_xyzw": [0, 0, 0, 1]},
        "frame_id": "chaser",
        "stamp_ns": 1,
        "covariance": np.eye(6).tolist(),
        "keep_gid": "0" * 32,
    },
    {"epoch_ns": 10**18, "duration_s": 10.0},
    {"name": "run"},
    {"fault": "blackout", "start_s": 0.0, "duration_s": 1.0},
    {},
)
CONFIGURATIONS: tuple[tuple[type[BaseModel], Any], ...] = (
    (EstimatorConfig, {"target": "mockup", "sensors": [{"kind": "pmd"}, {"kind": "lidar"}]}),
    (EmulatorConfig, {"target": "mockup", "sensors": [{"kind": "pmd"}, {"kind": "lidar"}], "seed": 1}),
    (MotionServiceConfig, {"target": "mockup", "duration_s": 10.0}),
    (LoggerConfig, {"directory": "runs", "name": "run", "record_extra": ["0/lab/**"]}),
    (RouterConfig, {"listen": "tcp/127.0.0.1:7447", "estimators": ["e1"]}),
)


@dataclass(frozen=True)
class Subject:
    """One thing that reads what others wrote."""

    name: str
    make: Callable[[Random], bytes]
    """Makes a hostile input."""
    read: Callable[[bytes], bool]
    """Reads it: whether it was accepted. It raises only where something is wrong with the reader."""


@cache
def subjects() -> dict[str, Subject]:
    """Return all subjects by name."""
    kinds = (call_subjects, record_subjects, log_subjects, mesh_subjects, device_subjects)
    others = (Subject(*each) for of_kind in kinds for each in of_kind())
    found = (*_messages(), *_wire(), *_requests(), *_configurations(), *others)
    return {subject.name: subject for subject in found}


def _messages() -> Iterator[Subject]:
    for topic in TOPICS:
        readers = READERS.get(topic.type, ())
        yield Subject(
            f"message {topic.name}",
            partial(_make_message, topic),
            partial(_read_message, topic.type, readers),
        )
    yield Subject(pictures.NAME, pictures.make, pictures.read)
    yield Subject("frames", _make_frames, _read_frames)
    yield Subject("heartbeats", _make_heartbeat, _read_heartbeat)


def _make_message(topic: Topic, rnd: Random) -> bytes:
    return mutate_message(rnd, messages()[topic], topic.type)


def _read_message(type_name: str, readers: tuple[Callable[[Any], Any], ...], data: bytes) -> bool:
    accepted = False
    for read in readers:
        try:
            peek_stamp(data)
            read(decode(memoryview(data), type_name))
            accepted = True
        except MessageRejectedError:
            continue
    return accepted


# --- the estimator's reader of frames ---


def _make_frames(rnd: Random) -> bytes:
    """Return a few messages of all streams, most of them valid, each behind topic, peer and length."""
    out, known = b"", list(messages().items())
    for _ in range(rnd.randint(3, 12)):
        index = rnd.randrange(len(known))
        topic, payload = known[index]
        data = payload if rnd.randrange(6) else mutate_message(rnd, payload, topic.type)
        out += bytes([index, rnd.randrange(3)]) + len(data).to_bytes(4, "little") + data
    return out


def _read_frames(data: bytes) -> bool:
    reader, known, used = FrameReader((PmdInput(), LidarInput())), list(messages()), False
    at = sequence = 0
    while at + 6 <= len(data):
        topic, peer = known[data[at] % len(known)], data[at + 1]
        size = int.from_bytes(data[at + 2 : at + 6], "little")
        payload = memoryview(data)[at + 6 : at + 6 + size]
        at, sequence = at + 6 + size, sequence + 1
        received = Received(
            topic,
            topic.name,
            payload,
            Attachment(sequence, 0, bytes([peer] * GID_BYTES)),
            0,
            session=str(peer),
        )
        try:
            used |= _put(reader, received)
        except (MessageRejectedError, PartRejectedError):
            continue
    return used


def _put(reader: FrameReader, received: Received) -> bool:
    if received.topic in reader.latched:
        reader.learn(received)
    elif received.topic.name in reader.parts:
        sensor, part = reader.parts[received.topic.name]
        frames = reader.assemblers[sensor].add(part, reader.stamp_ns(sensor, received), received)
        for frame in frames:
            reader.measurement(sensor, frame)
        return bool(frames)
    return False


# --- the logger's reader of heartbeats ---


def _make_heartbeat(rnd: Random) -> bytes:
    return _make_message(DIAGNOSTICS, rnd)


def _read_heartbeat(data: bytes) -> bool:
    ends = PublisherEnds(lambda _: True, Link(HealthBook("logger"), ""), own="")
    ends.came("s", DIAGNOSTICS)
    ends.receive(
        Received(DIAGNOSTICS, "k", memoryview(data), Attachment(1, 0, bytes(GID_BYTES)), 0, session="s")
    )
    ends.gone("s", DIAGNOSTICS, now_s=1.0, now_ns=10**9)
    for now_s in (8.0, 8.9, 9.8):  # within less than a second of each other: the process did not stand still
        ends.decide(now_s)
    return bool(ends.take(0).reasons)


# --- attachments, tokens, sequences ---


def _wire() -> Iterator[Subject]:
    good = Attachment(7, 10**18, bytes(range(GID_BYTES))).pack()
    yield Subject("attachment", lambda rnd: mutate_bytes(rnd, good), _read_attachment)
    yield Subject("token", _make_token, _read_token)
    yield Subject("sequence", lambda rnd: rnd.randbytes(10 * rnd.randint(1, 60)), _read_sequence)


def _read_attachment(data: bytes) -> bool:
    try:
        unpack_attachment(data)
    except MessageRejectedError:
        return False
    return True


def _make_token(rnd: Random) -> bytes:
    topic = Topic("pmd/depth/image_raw", "sensor_msgs/msg/Image")
    parts = GraphNode(Namespace(), "a1", "node").endpoint_token("MP", 1, topic).split("/")
    for _ in range(rnd.randint(1, 3)):
        parts[rnd.randrange(2, len(parts))] = rnd.choice(
            ("", "%", "::", "a::msg::dds_::b", "::msg::dds_::", "x::msg::dds_::y::z", "%%", "é")
        )
    return "/".join(parts).encode()


def _read_token(data: bytes) -> bool:
    token = data.decode("utf-8", errors="replace")
    if token.count("/") < EVERY_PUBLISHER.count("/"):
        return False  # no subscription to tokens matches it
    return bool(session_of_token(token)) and topic_of_token(token, Namespace()) is not None


def _read_sequence(data: bytes) -> bool:
    account, accepted = SequenceAccount(), 0
    for at in range(0, len(data) - 9, 10):
        sequence = int.from_bytes(data[at + 1 : at + 9], "little") >> data[at + 9] % 64
        try:
            account.take(
                "k", Attachment(sequence, 0, bytes([data[at] % 3] * GID_BYTES)), fetched=data[at] > 200
            )
            accepted += 1
        except (DuplicateError, JumpError):
            continue
    count = account.counts["k"]
    assert count.received == accepted
    assert 0 <= count.recovered <= accepted
    assert count.missed >= 0
    return accepted > 1


# --- queries and configuration ---


def _requests() -> Iterator[Subject]:
    for model, seed in zip(REQUESTS, _REQUEST_SEEDS, strict=True):
        yield Subject(
            f"query {model.__name__}",
            partial(_make_document, seed),
            partial(_read_request, model),
        )


def _make_document(seed: Any, rnd: Random) -> bytes:
    return json_of(rnd, mutate_document(rnd, seed))


def _read_request(model: type[BaseModel], data: bytes) -> bool:
    try:
        model.model_validate_json(data).model_dump_json()
    except ValidationError:
        return False
    return True


def _configurations() -> Iterator[Subject]:
    scenarios = Path(__file__).parents[2] / "services" / "rpod" / "scenarios"
    seeds = [
        *CONFIGURATIONS,
        *((Scenario, yaml.safe_load(file.read_text("utf-8"))) for file in scenarios.glob("*.yaml")),
    ]
    for number, (model, seed) in enumerate(seeds):
        yield Subject(
            f"configuration {number} {model.__name__}",
            partial(_make_document, seed),
            partial(_read_file, partial(load, model)),
        )
    folder = Path(load_equivalence.__code__.co_filename).parent / "targets"
    for name in shipped_targets()[:4]:
        seed = yaml.safe_load((folder / f"{name}.yaml").read_text("utf-8"))
        yield Subject(f"target {name}", partial(_make_document, seed), partial(_read_file, load_equivalence))


def _read_file(read: Callable[[Path], Any], data: bytes) -> bool:
    with TemporaryDirectory() as folder:
        file = Path(folder) / "file.yaml"
        file.write_bytes(data)
        try:
            read(file)
        except ConfigurationError:
            return False
    return True
