"""Faults of a frame's content: lost, frozen or wrong pixels and points, and wrong axes."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.lens import ray_cosines
from rpod_schemas.arrays import FloatArray
from rpod_schemas.messages import (
    read_camera,
    read_image,
    read_points,
    read_stamp,
    write_image,
    write_points,
)
from rpod_sim_sensor.faults.injection import Injection, Outgoing, stamped

Fields = dict[str, NDArray[np.float32]]
_PATCHES = 12
"""Number of patches along each side of the image; a fault takes whole patches, not single pixels."""


def with_image(outgoing: Outgoing, change: Callable[[NDArray[Any]], NDArray[Any]]) -> Outgoing:
    """Return an image with other pixels; ``change`` gets a copy of them."""
    message = outgoing.message
    image = change(read_image(message).copy())
    return replace(
        outgoing,
        message=write_image(
            read_stamp(message.header), message.header.frame_id, np.ascontiguousarray(image), message.encoding
        ),
    )


def with_points(outgoing: Outgoing, change: Callable[[Fields], Fields]) -> Outgoing:
    """Return a cloud with other points; ``change`` gets copies of its fields."""
    message = outgoing.message
    fields = change({name: values.copy() for name, values in read_points(message).items()})
    return replace(
        outgoing, message=write_points(read_stamp(message.header), message.header.frame_id, fields)
    )


def without(outgoing: Outgoing, lost: NDArray[np.bool_]) -> Outgoing:
    """Return an image or a cloud without the pixels or points of a mask of its shape."""

    def darken(image: NDArray[Any]) -> NDArray[Any]:
        image[lost] = np.nan if outgoing.part == "depth" and image.dtype.kind == "f" else 0
        return image

    def forget(fields: Fields) -> Fields:
        for axis in "xyz":
            fields[axis][lost] = np.nan
        return fields

    return with_points(outgoing, forget) if outgoing.part == "points" else with_image(outgoing, darken)


def size_of(outgoing: Outgoing) -> tuple[int, ...]:
    """Return the shape of an image, or that of a cloud."""
    message = outgoing.message
    return (
        (message.height, message.width)
        if message.height > 1 or outgoing.part != "points"
        else (message.width,)
    )


def patches(shape: tuple[int, ...], share: float, random: np.random.Generator) -> NDArray[np.bool_]:
    """Return a mask of patches, of a shape with one or two axes, that holds a share of them."""
    lost = random.random((_PATCHES, _PATCHES)) < share
    places = [np.arange(size) * _PATCHES // size for size in shape]
    mask: NDArray[np.bool_] = lost[np.ix_(*places)] if len(places) == 2 else lost.ravel()[places[0]]
    return mask


class Content(Injection):
    """A fault of images and points; the parts in ``changes`` are passed to ``changed``."""

    changes: ClassVar[tuple[str, ...]] = ("depth", "points", "image")

    def part(self, outgoing: Outgoing, elapsed_s: float) -> list[Outgoing]:  # noqa: ARG002
        """Return the changed message."""
        return [self.changed(outgoing) if outgoing.part in self.changes else outgoing]

    def changed(self, outgoing: Outgoing) -> Outgoing:
        """Return the message as the fault makes it."""
        raise NotImplementedError


class Dropout(Content):
    """Loss of the depth or returns of some patches; of 60 % of them by default."""

    fault = "dropout"

    def changed(self, outgoing: Outgoing) -> Outgoing:
        """Return the message without these patches, which are the same in all parts of a frame."""
        return without(outgoing, patches(size_of(outgoing), self.share, self.random(outgoing)))

    @property
    def share(self) -> float:
        """Share of the patches that is lost."""
        return self.size or 0.0


class Glints(Dropout):
    """Loss of the depth and amplitude of some patches; of 40 % of them by default."""

    fault = "glints"
    changes = ("depth", "points", "image", "amplitude")


class Blackout(Glints):
    """Loss of all depth, amplitude and returns."""

    fault = "blackout"

    @property
    def share(self) -> float:
        """All patches."""
        return 1.0


class Partial(Content):
    """Loss of the last rows, or of the last part of the scan, of one frame in three; 40 % by default."""

    fault = "partial"
    changes = ("depth", "points", "image", "amplitude")

    def changed(self, outgoing: Outgoing) -> Outgoing:
        """Return the first part of the message."""
        if self.random(outgoing).random() > 1 / 3:
            return outgoing
        kept = round((1.0 - (self.size or 0.0)) * size_of(outgoing)[-1 if outgoing.part == "points" else 0])
        if outgoing.part == "points":
            return with_points(
                outgoing, lambda fields: {name: part[..., :kept] for name, part in fields.items()}
            )
        lost = np.zeros(size_of(outgoing), bool)
        lost[kept:] = True
        return without(outgoing, lost)


class Frozen(Injection):
    """Repetition of the first content of each topic, under new stamps."""

    fault = "frozen"

    def __init__(self, kind: str, seed: int) -> None:
        super().__init__(kind, seed)
        self._first: dict[str, Outgoing] = {}

    def part(self, outgoing: Outgoing, elapsed_s: float) -> list[Outgoing]:  # noqa: ARG002
        """Return the first message of the topic under this stamp."""
        return [stamped(self._first.setdefault(outgoing.topic.name, outgoing), outgoing.stamp_ns)]


class Saturation(Content):
    """The brightest 40 % of the lit pixels are clipped at the encoding's largest value."""

    fault = "saturation"
    changes = ("amplitude",)

    def changed(self, outgoing: Outgoing) -> Outgoing:
        """Return the clipped image."""

        def clip(image: NDArray[Any]) -> NDArray[Any]:
            lit = image[image > 0]
            if lit.size:
                bright = image >= np.quantile(lit, 0.6)
                image[bright] = np.iinfo(image.dtype).max if image.dtype.kind == "u" else lit.max()
            return image

        return with_image(outgoing, clip)


class ZerosForNone(Content):
    """Zeros in place of NaN."""

    fault = "zeros_for_none"

    def changed(self, outgoing: Outgoing) -> Outgoing:
        """Return the image without NaN."""
        return with_image(outgoing, lambda image: np.nan_to_num(image, nan=0.0))


class Scaled(Content):
    """Distances in millimetres."""

    fault, factor = "millimetres", 1000.0

    @property
    def offset_m(self) -> float:
        """Length that is added to each distance, m."""
        return 0.0

    def changed(self, outgoing: Outgoing) -> Outgoing:
        """Return the message with other distances; an offset is along the boresight, or along each ray."""

        def farther(fields: Fields) -> Fields:
            xyz = np.stack([fields[axis] for axis in "xyz"])
            range_m = np.linalg.norm(xyz, axis=0)
            with np.errstate(invalid="ignore", divide="ignore"):
                scale = np.where(range_m > 0, self.factor + self.offset_m / range_m, 1.0).astype(np.float32)
            return fields | {axis: fields[axis] * scale for axis in "xyz"}

        if outgoing.part == "points":
            return with_points(outgoing, farther)
        return with_image(outgoing, lambda image: image * np.float32(self.factor) + np.float32(self.offset_m))


class Biased(Scaled):
    """Distances that are too long; by 15 cm by default."""

    fault, factor = "biased", 1.0

    @property
    def offset_m(self) -> float:
        """Length that is added to each distance, m."""
        return self.size or 0.0


class RadialDepth(Content):
    """Depth along each pixel's ray."""

    fault = "radial_depth"

    def __init__(self, kind: str, seed: int) -> None:
        super().__init__(kind, seed)
        self._cosines: FloatArray | None = None

    def part(self, outgoing: Outgoing, elapsed_s: float) -> list[Outgoing]:
        """Learn the lens, and change depth."""
        if outgoing.part == "camera_info" and self._cosines is None:
            self._cosines = ray_cosines(read_camera(outgoing.message))
        return super().part(outgoing, elapsed_s)

    def changed(self, outgoing: Outgoing) -> Outgoing:
        """Return the radial depth; the image itself until the lens is known."""
        cosines = self._cosines
        if cosines is None:
            return outgoing
        return with_image(outgoing, lambda image: (image / cosines).astype(np.float32))


class Mirrored(Content):
    """Left and right exchanged."""

    fault = "mirrored"
    changes = ("depth", "points", "image", "amplitude")

    def changed(self, outgoing: Outgoing) -> Outgoing:
        """Return the mirrored message."""
        if outgoing.part == "points":
            return with_points(outgoing, lambda fields: fields | {"x": -fields["x"]})
        return with_image(outgoing, lambda image: image[:, ::-1])


class Transposed(Content):
    """Rows and columns of an organised scan exchanged."""

    fault = "transposed"
    changes = ("points",)

    def changed(self, outgoing: Outgoing) -> Outgoing:
        """Return the transposed cloud."""
        return with_points(outgoing, lambda fields: {name: part.T for name, part in fields.items()})


class ForwardAxes(Content):
    """Axes x forward, y left, z up."""

    fault = "forward_axes"
    changes = ("points",)

    def changed(self, outgoing: Outgoing) -> Outgoing:
        """Return the cloud in these axes."""
        return with_points(
            outgoing, lambda points: points | {"x": points["z"], "y": -points["x"], "z": -points["y"]}
        )


class WrongEncoding(Content):
    """Depth as an image of bytes."""

    fault = "wrong_encoding"
    changes = ("depth",)

    def changed(self, outgoing: Outgoing) -> Outgoing:
        """Return depth scaled to 8 bits."""
        message = outgoing.message
        grey = np.nan_to_num(20.0 * read_image(message).astype(np.float64), nan=0.0).clip(0, 255)
        stamp_ns, frame_id = read_stamp(message.header), message.header.frame_id
        return replace(outgoing, message=write_image(stamp_ns, frame_id, grey.astype(np.uint8), "mono8"))


class WrongSize(Content):
    """Images of half the size, with the camera_info of the full size."""

    fault = "wrong_size"
    changes = ("depth", "image", "amplitude")

    def changed(self, outgoing: Outgoing) -> Outgoing:
        """Return every second pixel of every second row."""
        return with_image(outgoing, lambda image: image[::2, ::2])


class NoPointTimes(Content):
    """Points without times."""

    fault = "no_point_times"
    changes = ("points",)

    def changed(self, outgoing: Outgoing) -> Outgoing:
        """Return the cloud without the field t."""
        return with_points(
            outgoing, lambda fields: {name: part for name, part in fields.items() if name != "t"}
        )


class PointTimeUnit(Content):
    """Times in a hundredth of the field's unit."""

    fault = "point_time_unit"
    changes = ("points",)

    def changed(self, outgoing: Outgoing) -> Outgoing:
        """Return the cloud with times that are a hundred times too small."""
        return with_points(outgoing, lambda fields: fields | {"t": fields["t"] * np.float32(0.01)})


class AmplitudeLags(Injection):
    """The amplitude of the frame before, under the stamp of the depth."""

    fault = "amplitude_lags"

    def __init__(self, kind: str, seed: int) -> None:
        super().__init__(kind, seed)
        self._held: Outgoing | None = None

    def part(self, outgoing: Outgoing, elapsed_s: float) -> list[Outgoing]:  # noqa: ARG002
        """Return the earlier amplitude in place of this one; the first one as it is."""
        if outgoing.part != "amplitude":
            return [outgoing]
        held, self._held = self._held or outgoing, outgoing
        return [stamped(held, outgoing.stamp_ns)]


INJECTIONS: dict[str, type[Injection]] = {
    each.fault: each
    for each in (
        Dropout, Glints, Blackout, Partial, Frozen, Saturation, ZerosForNone, Scaled, Biased, RadialDepth,
        Mirrored, Transposed, ForwardAxes, WrongEncoding, WrongSize, NoPointTimes, PointTimeUnit,
        AmplitudeLags,
    )
}  # fmt: skip
"""Injections of this module by the fault's name."""
