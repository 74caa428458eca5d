import numpy as np
import pytest

from rpod_emulator.faults import Fault, Faults, lost_cells, takes_amplitude

SHAPE = (287, 352)


def test_a_fault_holds_from_its_start_to_before_its_end():
    faults = Faults()
    faults.add(Fault("blackout", 10, 20))
    assert [faults.at(stamp_ns) for stamp_ns in (9, 10, 19, 20)] == [None, "blackout", "blackout", None]


def test_the_fault_that_was_asked_for_last_wins():
    faults = Faults()
    faults.add(Fault("dropout", 0, 100))
    faults.add(Fault("silence", 40, 60))
    assert [faults.at(stamp_ns) for stamp_ns in (30, 50, 70)] == ["dropout", "silence", "dropout"]


@pytest.mark.parametrize("kind", [None, "silence"])
def test_without_a_fault_of_the_image_nothing_is_lost(kind):
    assert lost_cells(kind, SHAPE, seed=1, number=1) is None


def test_a_blackout_takes_everything():
    assert lost_cells("blackout", SHAPE, seed=1, number=1).all()


def test_a_dropout_takes_60_percent_of_the_image_in_patches():
    shares = [lost_cells("dropout", SHAPE, seed=1, number=number).mean() for number in range(50)]
    assert 0.57 < np.mean(shares) < 0.63
    lost = lost_cells("dropout", SHAPE, seed=1, number=1)
    edges = np.count_nonzero(lost[:, 1:] != lost[:, :-1], axis=1)
    assert edges.max() <= 11, "no more borders than between twelve patches"


def test_glints_take_40_percent_of_depth_and_amplitude() -> None:
    shares = [lost_cells("glints", SHAPE, seed=1, number=number).mean() for number in range(50)]
    assert 0.37 < np.mean(shares) < 0.43
    takers = {kind for kind in (None, "dropout", "glints", "blackout", "silence") if takes_amplitude(kind)}
    assert takers == {"glints", "blackout"}, "a dropout is the camera's mask: it leaves the amplitude"


def test_a_dropout_is_that_of_its_frame_whenever_it_is_made():
    first = lost_cells("dropout", SHAPE, seed=1, number=7)
    np.testing.assert_array_equal(lost_cells("dropout", SHAPE, seed=1, number=7), first)
    assert (lost_cells("dropout", SHAPE, seed=1, number=8) != first).any()
    assert (lost_cells("dropout", SHAPE, seed=2, number=7) != first).any()


@pytest.mark.parametrize("shape", [(1, 1), (5, 41), (12, 12), (41, 7)])
def test_a_scan_of_any_size_can_drop_out(shape):
    assert lost_cells("dropout", shape, seed=1, number=1).shape == shape
