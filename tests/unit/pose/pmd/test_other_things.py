"""What a PMD frame keeps of other things: pixels without a range, and the light at the outline."""

from typing import ClassVar

import numpy as np
import pytest

from rpod_pose.pmd import other_things
from rpod_pose.pmd.other_things import PmdFrames
from rpod_pose.surroundings.separation import Label
from rpod_schemas.types import Camera, PmdFrame

ROWS, COLUMNS = 40, 60
CAMERA = Camera(width=COLUMNS, height=ROWS, fx=60.0, fy=60.0, cx=29.5, cy=19.5)
SKY = 1
"""Amplitude of a pixel that sees nothing, of a frame without sky."""


class Laboratory:
    """A target of 20 x 20 pixels before a wall, and an arm beside it."""

    target, wall, arm = (4.0, 200), (6.5, 120), (3.0, 220)
    on_target: ClassVar[tuple[slice, slice]] = (slice(10, 30), slice(20, 40))
    on_arm: ClassVar[tuple[slice, slice]] = (slice(0, 9), slice(26, 34))

    def __init__(self) -> None:
        self.depth_m = np.full((ROWS, COLUMNS), self.wall[0], np.float32)
        self.amplitude = np.full((ROWS, COLUMNS), self.wall[1], np.uint16)
        self.labels = np.full((ROWS, COLUMNS), Label.BEYOND, np.uint8)
        for pixels, (depth_m, amplitude), label in (
            (self.on_target, self.target, Label.KEPT),
            (self.on_arm, self.arm, Label.HIDING),
        ):
            self.depth_m[pixels], self.amplitude[pixels], self.labels[pixels] = depth_m, amplitude, label

    @property
    def frame(self) -> PmdFrame:
        return PmdFrame(
            stamp_ns=0, frame_id="", depth_m=self.depth_m, amplitude=self.amplitude, camera=CAMERA
        )

    def lose(self, *pixels: tuple[int | slice, int | slice]) -> None:
        """Take the range of some pixels, so that nothing tells whether they are the target's."""
        for each in pixels:
            self.depth_m[each] = np.nan
            self.labels[each] = Label.KEPT

    def separated(self) -> PmdFrame:
        return PmdFrames().separated(self.frame, self.labels, np.zeros((ROWS, COLUMNS), bool))


def test_a_pixel_of_a_wall_or_of_an_arm_without_a_range_is_no_part_of_the_target():
    laboratory = Laboratory()
    laboratory.lose((5, 10), (35, 50), (4, 30), (20, 30))
    separated = laboratory.separated()
    np.testing.assert_array_equal(separated.amplitude[[5, 35], [10, 50]], SKY)
    assert separated.amplitude[4, 30] == 0
    assert separated.hidden[4, 30]
    assert separated.amplitude[20, 30] == Laboratory.target[1]


def test_a_dark_side_of_the_target_without_a_range_stays_to_its_outline():
    laboratory = Laboratory()
    side = slice(10, 30), slice(20, 30)
    laboratory.amplitude[side] = 30
    laboratory.lose(side)
    np.testing.assert_array_equal(laboratory.separated().amplitude[side], 30)


def test_a_part_of_a_room_without_a_range_that_reaches_beyond_the_place_is_not_the_targets():
    laboratory = Laboratory()
    laboratory.lose((slice(32, 40), slice(0, 60)))
    laboratory.labels[36:] = Label.BEYOND
    np.testing.assert_array_equal(laboratory.separated().amplitude[32:], SKY)
    alone = Laboratory()
    alone.lose((slice(33, 36), slice(5, 15)))  # as large, but it ends within the place
    np.testing.assert_array_equal(alone.separated().amplitude[34, 6:14], Laboratory.wall[1])


@pytest.mark.parametrize("covered", [0.0, 0.3, 0.7, 1.0])
@pytest.mark.parametrize("measured", [False, True])
def test_light_tells_how_much_of_an_outlines_pixel_a_target_without_a_range_covers(covered, measured):
    laboratory, dark, column = Laboratory(), 40, 40
    laboratory.amplitude[laboratory.on_target] = dark
    laboratory.lose(laboratory.on_target)
    laboratory.amplitude[10:30, column] = covered * dark + (1.0 - covered) * Laboratory.wall[1]
    if not measured:
        laboratory.lose((slice(10, 30), column))
    outline = laboratory.separated().amplitude[13:27, column]
    np.testing.assert_allclose(outline, max(covered * dark, SKY), atol=1.5)


def test_the_noise_of_a_range_follows_from_its_light_and_from_its_neighbours():
    laboratory = Laboratory()
    sigma_m = 4.0 / laboratory.amplitude
    laboratory.depth_m += np.random.default_rng(1).normal(0.0, sigma_m).astype(np.float32)
    image = PmdFrames().image(laboratory.frame, fine=True)
    np.testing.assert_allclose(image.sigma_m, sigma_m, rtol=0.15)
    assert PmdFrames().image(laboratory.frame, fine=False).sigma_m is None


def test_amplitudes_may_be_of_any_size():
    lab = Laboratory()
    depth_m = lab.depth_m.copy()
    depth_m[30:] = np.nan
    bright = lab.amplitude.astype(np.float32) * 1e5
    bright[30:] = 1e6
    frame = lab.frame.model_copy(update={"depth_m": depth_m, "amplitude": bright})
    touching = np.zeros((ROWS, COLUMNS), bool)
    separated = PmdFrames().separated(frame, lab.labels, touching)
    assert np.isfinite(separated.amplitude).all()


@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_the_light_of_others_is_taken_away_around_the_target_alone_with_the_same_result(monkeypatch, dtype):
    laboratory, generator = Laboratory(), np.random.default_rng(1)
    laboratory.depth_m += generator.normal(0.0, 0.02, (ROWS, COLUMNS)).astype(np.float32)
    laboratory.lose((slice(12, 20), slice(24, 46)), (slice(2, 6), 30))
    lost = generator.random((ROWS, COLUMNS)) < 0.1
    laboratory.depth_m[lost] = np.nan
    laboratory.amplitude = (laboratory.amplitude * generator.uniform(0.8, 1.2, (ROWS, COLUMNS))).astype(dtype)
    around = laboratory.separated()
    monkeypatch.setattr(other_things, "window_around", lambda *_: (slice(None), slice(None)))
    whole = laboratory.separated()
    for name in ("depth_m", "amplitude", "hidden"):
        np.testing.assert_array_equal(getattr(around, name), getattr(whole, name), name)


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
def test_the_unit_of_a_float_amplitude_does_not_matter(unit: float):
    laboratory, other = Laboratory(), Laboratory()
    laboratory.amplitude = laboratory.amplitude.astype(np.float32) + np.float32(0.5)
    other.amplitude = laboratory.amplitude * np.float32(unit)
    separated, scaled = laboratory.separated().amplitude, other.separated().amplitude
    np.testing.assert_allclose(scaled, separated * np.float32(unit), rtol=1e-5)
    assert separated[0, 0] < 0.01 * Laboratory.target[1]  # the wall is dark
    noise = [PmdFrames().image(each.frame, fine=True).sigma_m for each in (laboratory, other)]
    np.testing.assert_allclose(*noise, rtol=1e-5)
