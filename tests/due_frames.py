"""All frames of sensors in a span of time, as the tests of lockstep expect them."""

from collections.abc import Iterator, Sequence

from rpod_schemas.config.emulator import SensorConfig
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.schedule import DueFrame, frame_at, last_number


def due_frames(sensors: Sequence[SensorConfig], *, epoch_ns: int, duration_s: float) -> Iterator[DueFrame]:
    """Yield all frames with stamps in (epoch, epoch + duration], in order."""
    until_ns = epoch_ns + round(duration_s * NANOSECONDS)
    frames = [
        frame_at(sensor, number, epoch_ns=epoch_ns)
        for sensor in sensors
        for number in range(1, last_number(sensor, until_ns, epoch_ns=epoch_ns) + 1)
    ]
    yield from sorted(frames)
