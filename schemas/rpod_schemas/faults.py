"""The catalogue of faults of sensors: what goes wrong, why, how it is recognised, and what to do about it.

One catalogue serves all: ``rpod_sim_sensor.faults`` injects them, scenarios and the emulator's query ask for
them by name, and ``rpod driver check`` names them. ``docs/reference/faults.md`` of the site is made from it.
"""

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from rpod_schemas.config.base import Config, Name, NonNegative, Positive
from rpod_schemas.errors import SchemaError

Evidence = Literal["rate", "truth", "plane", "info"]
"""What a fault is only seen with: the sensor's nominal rate; truth, mount and target model; a plane in view,
or truth; the sensor's info message."""
BOTH = ("pmd", "lidar")


@dataclass(frozen=True)
class Fault:
    """One kind of fault of a sensor, its driver or its network."""

    name: str
    """Name in queries, scenarios and verdicts."""
    cause: str
    """What is wrong, and where it usually comes from."""
    line: str
    """Line of ``rpod driver check`` that reports it."""
    remedy: str
    """What to do."""
    kinds: tuple[str, ...] = BOTH
    """Kinds of sensors that can have it."""
    needs: Evidence | None = None
    """What the check needs to see it; None if the messages alone tell."""
    in_lockstep: bool = False
    """Whether it can be injected in lockstep: each frame still comes, once, under its own stamp."""
    from_start: bool = False
    """Whether it can only be injected from the start of the sensor."""


_DRIVER = "let the driver"
_CAMERA = ("pmd",)
_LIDAR = ("lidar",)

FAULTS: tuple[Fault, ...] = (
    # --- frames that do not come, or not as often ---
    Fault(
        "silence",
        "no frames: power, cable, or a driver that hangs",
        "publisher",
        "look at the sensor's power and link, and at the driver's diagnostics",
    ),
    Fault(
        "slow_rate",
        "fewer frames than nominal: exposure too long, link or processor too slow",
        "rate",
        "look at the exposure time, the link's speed and the processor's load",
        needs="rate",
    ),
    Fault(
        "lost_frames",
        "single frames are missing before they are published: a full queue, lost packets",
        "gaps",
        "look at the driver's counters of lost frames (device, queue); use a dedicated link, jumbo frames, a "
        "larger receive buffer",
    ),
    Fault(
        "stall",
        "no frames for a while, again and again: reconnections, power saving, garbage",
        "gaps",
        "look at the driver's log at these times; switch off power saving of port and processor",
    ),
    Fault(
        "lost_messages",
        "messages are published and do not arrive: the bus drops them on a slow link",
        "bus",
        "look at the network between driver and receiver; lower the rate or the resolution",
    ),
    Fault(
        "slow_link",
        "messages wait on their way: the link carries less than the sensor sends",
        "bus",
        "use a faster link, lower the rate or the resolution, or run the estimator beside the sensor",
    ),
    Fault(
        "second_publisher",
        "two processes publish the same topics: an old driver still runs",
        "publisher",
        "stop one of the publishers",
    ),
    # --- parts of frames ---
    Fault(
        "missing_part",
        "a part without which there is no frame does not come: camera_info",
        "parts",
        f"{_DRIVER} publish it, with the stamp of its frame",
        kinds=_CAMERA,
    ),
    Fault(
        "unpaired_parts",
        "the parts of a frame carry different stamps: each is stamped on its own",
        "parts",
        f"{_DRIVER} stamp all parts of a frame alike, or set source.pair_within_s",
        kinds=_CAMERA,
    ),
    Fault(
        "partial",
        "only a part of a frame or scan comes: lost packets",
        "partial",
        "use a dedicated link and a larger receive buffer; leave partial frames out",
        in_lockstep=True,
    ),
    # --- stamps ---
    Fault(
        "tai_clock",
        "stamps in TAI, 37 s ahead of UTC: a PTP clock taken as it is",
        "clock",
        f"{_DRIVER} subtract 37 s, or set source.clock_offset_s to 37",
    ),
    Fault("local_time", "stamps in local time", "clock", f"{_DRIVER} stamp in UTC"),
    Fault(
        "boot_clock",
        "stamps count from the start of the device",
        "clock",
        f"{_DRIVER} map the device's clock to UTC, or synchronise the device by PTP",
    ),
    Fault(
        "clock_ahead",
        "stamps are ahead of this machine's clock: a clock is not synchronised",
        "clock",
        "synchronise both clocks (PTP, or chrony), or set source.clock_offset_s",
    ),
    Fault(
        "clock_behind",
        "stamps are older than transport explains: clock not synchronised, or a long queue",
        "clock",
        "synchronise both clocks (PTP, or chrony); shorten queues between device and driver",
    ),
    Fault(
        "clock_drift",
        "the sensor's clock runs faster or slower than this machine's",
        "drift",
        "synchronise the sensor by PTP, or map its clock to UTC continuously",
    ),
    Fault(
        "stamp_jitter",
        "stamps are irregular: taken when the frame arrives, not when it is exposed",
        "jitter",
        f"{_DRIVER} use the device's stamps, mapped to UTC",
    ),
    Fault(
        "repeated_stamps",
        "two frames carry the same stamp",
        "order",
        f"{_DRIVER} give each frame a stamp of its own, and publish it once",
    ),
    Fault(
        "reordered_stamps",
        "stamps go back: frames are published out of order",
        "order",
        f"{_DRIVER} publish frames in the order of their exposure",
    ),
    Fault(
        "stamp_start",
        "stamps are of the start of the exposure or scan, not of its middle",
        "instant",
        f"{_DRIVER} add half the duration, or set source.stamp and source.duration_s",
        needs="truth",
    ),
    # --- content ---
    Fault(
        "frozen",
        "the same content again under new stamps: a driver that repeats its last frame",
        "frozen",
        "restart the driver; let it raise an error where the device delivers nothing new",
        in_lockstep=True,
    ),
    Fault(
        "blackout",
        "frames without a single return: shutter, lamp off, wrong exposure, nothing in view",
        "returns",
        "look at the lamp, at the exposure, and whether anything is in view",
        in_lockstep=True,
    ),
    Fault(
        "dropout",
        "depth is lost in patches that change from frame to frame",
        "returns",
        "look at the exposure, the reconstruction's filters and lost packets",
        in_lockstep=True,
    ),
    Fault(
        "glints",
        "depth and amplitude are lost in patches that change from frame to frame",
        "returns",
        "shield the scene from other lamps; look at lost packets",
        in_lockstep=True,
    ),
    Fault(
        "saturation",
        "many pixels are saturated: too much light for the exposure",
        "saturation",
        "shorten the exposure, or let the camera choose it",
        kinds=_CAMERA,
        in_lockstep=True,
    ),
    Fault(
        "zeros_for_none",
        "pixels without depth are 0 instead of NaN in 32FC1",
        "values",
        f"{_DRIVER} write NaN where there is no depth",
        kinds=_CAMERA,
        in_lockstep=True,
    ),
    Fault(
        "wrong_encoding",
        "an image has an encoding that depth cannot have",
        "content",
        f"{_DRIVER} send 32FC1 in metres, or 16UC1 in millimetres",
        kinds=_CAMERA,
        in_lockstep=True,
    ),
    Fault(
        "wrong_size",
        "image and camera_info differ in size: binning, region of interest",
        "content",
        f"{_DRIVER} publish the camera_info of the mode that the images are taken in",
        kinds=_CAMERA,
        in_lockstep=True,
    ),
    Fault(
        "millimetres",
        "distances are millimetres in a field of metres",
        "unit",
        f"{_DRIVER} send metres",
        in_lockstep=True,
    ),
    Fault(
        "radial_depth",
        "depth is the distance along each pixel's ray, not along the boresight",
        "depth_model",
        "convert it, or set source.depth to radial",
        kinds=_CAMERA,
        needs="plane",
        in_lockstep=True,
    ),
    Fault(
        "biased",
        "all distances are too long or too short: not calibrated",
        "range",
        "calibrate the distances: rpod calibrate",
        needs="truth",
        in_lockstep=True,
    ),
    # --- geometry ---
    Fault(
        "mirrored",
        "images or scans are mirrored",
        "grid",
        f"{_DRIVER} turn off the mirror",
        needs="truth",
        in_lockstep=True,
    ),
    Fault(
        "transposed",
        "rows and columns of a scan are exchanged",
        "grid",
        f"{_DRIVER} send one elevation a row, or set rows_are_elevation of the info",
        kinds=_LIDAR,
        needs="info",
        in_lockstep=True,
    ),
    Fault(
        "forward_axes",
        "points have x forward, y left, z up, not z along the boresight",
        "axes",
        "convert them, or set source.axes to forward",
        kinds=_LIDAR,
        in_lockstep=True,
    ),
    Fault(
        "wrong_pattern",
        "the info's directions are not those of the points: another scan mode",
        "grid",
        f"{_DRIVER} publish the info of the mode that it scans in",
        kinds=_LIDAR,
        needs="info",
        in_lockstep=True,
    ),
    Fault(
        "no_point_times",
        "points carry no times though a scan takes long: motion cannot be corrected",
        "point_times",
        f"{_DRIVER} send the field t, s from the stamp",
        kinds=_LIDAR,
        needs="info",
        in_lockstep=True,
    ),
    Fault(
        "point_time_unit",
        "times of points are in another unit, or count from another instant",
        "point_times",
        f"{_DRIVER} send t in seconds from the stamp",
        kinds=_LIDAR,
        needs="info",
        in_lockstep=True,
    ),
    Fault(
        "lens_unscaled",
        "camera_info holds the lens of another resolution",
        "lens",
        f"{_DRIVER} scale fx, fy, cx, cy with the image",
        kinds=_CAMERA,
        in_lockstep=True,
    ),
    Fault(
        "lens_changes",
        "camera_info changes while the camera runs",
        "lens",
        "fix focus and zoom; let one process publish camera_info",
        kinds=_CAMERA,
        in_lockstep=True,
    ),
    # --- mount ---
    Fault(
        "no_mount",
        "no transform leads from the sensor's frame to the chaser",
        "mount",
        "publish it on tf_static, or configure T_chaser_sensor",
        in_lockstep=True,
        from_start=True,
    ),
    Fault(
        "second_mount",
        "two publishers give the sensor's frame another place",
        "mount",
        "stop one of the publishers of tf_static",
        in_lockstep=True,
    ),
    Fault(
        "not_latched",
        "latched topics are published as volatile: who starts later never gets them",
        "qos",
        f"{_DRIVER} publish tf_static and info as RELIABLE, TRANSIENT_LOCAL",
        in_lockstep=True,
        from_start=True,
    ),
    Fault(
        "mount_off",
        "the published mount is not where the sensor is",
        "mount_truth",
        "calibrate the mount anew: rpod calibrate mount",
        needs="truth",
        in_lockstep=True,
    ),
)
"""All kinds of faults."""

BY_NAME = {fault.name: fault for fault in FAULTS}


def known_fault(name: str) -> Fault:
    """Return a fault by its name.

    Raises:
        SchemaError: there is none of this name.
    """
    if name not in BY_NAME:
        raise SchemaError(f"no fault {name!r}; known are {', '.join(BY_NAME)}")
    return BY_NAME[name]


def _known_name(name: str) -> str:
    try:
        return known_fault(name).name
    except SchemaError as error:
        raise ValueError(str(error)) from error


FaultName = Annotated[str, AfterValidator(_known_name)]
"""Name of a fault of the catalogue."""


class PlannedFault(Config):
    """A fault of an emulated sensor at a time of the scenario."""

    fault: FaultName
    """Name of the fault in the catalogue."""
    sensor: Name | None = None
    """Name of the sensor; all that can have the fault if left out."""
    start_s: NonNegative = 0.0
    """Start, s from the epoch. At 0 the fault is there before the first frame."""
    duration_s: Positive | None = Field(default=None)
    """Duration, s; until the end if left out."""
