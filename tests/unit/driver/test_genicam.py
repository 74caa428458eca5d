"""A GenICam camera: the simulated one of genicam's own producer, and fakes for what it has not."""

from itertools import islice
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from genicam_fakes import COUNTS, SCAN, Buffer, Nodes, component, faked

from rpod_driver.adapters.genicam.config import GenicamConfig
from rpod_driver.adapters.genicam.depth import Scan3d, amplitude_of, confident, depth_of
from rpod_driver.adapters.genicam.driver import open_driver
from rpod_driver.adapters.genicam.features import FeatureError
from rpod_driver.errors import DriverError
from rpod_schemas.types import Camera

LENS = {"width": 400, "height": 400, "fx": 300.0, "fy": 300.0, "cx": 199.5, "cy": 199.5}
RANGE = {"ComponentSelector": "Range", "ComponentEnable": True}


def simulated(**device):
    genicam = pytest.importorskip("genicam", reason="genicam is not installed (pip install --group devices)")
    pytest.importorskip("harvesters", reason="harvesters is not installed (pip install --group devices)")
    producer = Path(genicam.__file__).parent / "viky.cti"
    told = {"producer": producer, "select": {"id_": "VikyTL_DEV_red"}, "settings": RANGE, "calibration": LENS}
    return open_driver(GenicamConfig.model_validate({"name": "front", "device": told | device}))


def taken(driver, count):
    driver.connect()
    try:
        return [frame for frame in islice(driver.frames(), count) if frame is not None]
    finally:
        driver.close()


def test_a_simulated_camera_is_connected_read_and_connected_again(caplog):
    driver = simulated()
    for _ in range(2):
        frames = taken(driver, 3)
        assert len(frames) == 3
        depths = np.stack([frame.depth_m for frame in frames])
        assert depths.shape == (3, 400, 400)
        assert 0.02 < np.nanmax(depths) < 0.1  # it tells millimetres
        assert frames[0].amplitude is None  # its image is of colours
        assert (np.diff([frame.stamp_ns for frame in frames]) > 0).all()
    assert driver.sync().stamp_source == "host"
    assert "the device gives no stamps" in caplog.text
    assert "no grey image among RGBa8, Coord3D_A32f" in caplog.text


@pytest.mark.parametrize(
    ("device", "reason"),
    [
        ({"settings": {}}, "Scan3dDistanceUnit is None.*ComponentSelector: Range"),
        ({"settings": RANGE | {"Gain": 1}}, "no feature 'Gain'"),
        ({"settings": {"PixelFormat": "Mono99"}}, "it takes RGBa8, Mono8"),
        ({"trigger": "software"}, "no feature 'TriggerSelector'"),
        ({"select": {}}, r"several cameras \(Viky 0; Viky 1; Viky 2\)"),
        (
            {"select": {"serial_number": "7"}},
            r"device\.select .*'7'.* describes none of .*Viky 0; .*; correct it",
        ),
        ({"select": {"model": "Viky"}}, r"device\.select .* describes 3 of the cameras"),
        ({"producer": "/opt/none.cti"}, "which is no file"),
        ({"calibration": None}, "no Scan3dFocalLength"),
        ({"calibration": LENS | {"width": 640}}, "640 x 400 pixels, the camera sends 400 x 400"),
    ],
)
def test_what_a_camera_does_not_have_is_told_by_name_and_nothing_stays_open(device, reason):
    driver = simulated(**device)
    with pytest.raises(DriverError, match=reason):
        taken(driver, 1)
    driver = simulated()
    assert taken(driver, 1)


def test_counts_become_metres_by_scale_offset_and_unit():
    scan = Scan3d(Nodes(**SCAN), None)
    depth_m = depth_of([component("Mono8", COUNTS), component("Coord3D_C16", COUNTS)], scan)
    assert np.isnan(depth_m[0, 0])
    assert np.allclose(depth_m.ravel()[1:], (np.arange(1, 12) * 0.5 + 100) * 1e-3)
    assert (scan.camera(4, 3).fx, scan.camera(4, 3).cx) == (4.0, 1.5)


def test_of_interleaved_coordinates_the_third_is_depth():
    points = np.stack([COUNTS, COUNTS, COUNTS + 1000.0], axis=-1).astype(np.float32)
    scan = Scan3d(Nodes(**SCAN | {"Scan3dCoordinateScale": 1.0, "Scan3dCoordinateOffset": 0.0}), None)
    depth_m = depth_of([component("Coord3D_ABC32f", points)], scan)
    assert np.allclose(depth_m, (COUNTS + 1000) * 1e-3)


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"Scan3dOutputMode": "DisparityC"}, "DisparityC, which is no z-depth in an image"),
        ({"Scan3dOutputMode": "RectifiedC"}, "RectifiedC, which"),
        ({"Scan3dOutputMode": "CalibratedABC_PointCloud"}, "CalibratedABC_PointCloud, which"),
        ({"Scan3dOutputMode": "UncalibratedC"}, "UncalibratedC"),
        ({"Scan3dCoordinateSystem": "Spherical"}, "Spherical"),
        ({"Scan3dDistanceUnit": "Pixel"}, "Pixel, known are Millimeter"),
    ],
)
def test_coordinates_that_are_no_depth_are_refused(changed, reason):
    with pytest.raises(FeatureError, match=reason):
        Scan3d(Nodes(**SCAN | changed), None)


def test_amplitude_and_confidence_are_found_by_their_formats():
    parts = [component("Confidence8", COUNTS > 5), component("Mono12", COUNTS)]
    assert amplitude_of(parts).dtype == np.uint16
    assert np.array_equal(confident(parts), COUNTS > 5)
    assert confident([]) is None


def test_a_software_trigger_starts_each_frame_and_one_without_a_frame_is_counted(tmp_path):
    trigger = {"TriggerSelector": "", "TriggerMode": "Off", "TriggerSource": ""}
    nodes, buffers = Nodes(**SCAN | trigger), [Buffer(), Buffer()]
    driver = faked(nodes, [buffers[0], None, buffers[1]], tmp_path, trigger="software")
    driver.connect()
    got = list(islice(driver.frames(), 3))
    assert [frame is None for frame in got] == [False, True, False]
    assert nodes.executed == ["TriggerSoftware"] * 3
    assert (nodes.TriggerMode.value, nodes.TriggerSource.value) == ("On", "Software")
    told = driver.sync()
    assert (told.trigger, told.trigger_missed, told.stamp_source) == ("software", 1, "mapped")
    assert buffers[0].queued == 1
    assert np.array_equal(got[0].amplitude, COUNTS)


def test_a_hardware_trigger_names_its_input(tmp_path):
    trigger = {"TriggerSelector": "", "TriggerMode": "Off", "TriggerSource": ""}
    nodes = Nodes(**SCAN | trigger)
    driver = faked(nodes, [None], tmp_path, trigger="hardware", trigger_line="Line2")
    driver.connect()
    assert nodes.TriggerSource.value == "Line2"
    assert next(driver.frames()) is None
    assert not nodes.executed


@pytest.mark.parametrize(
    ("settings", "mode"), [({}, "Off"), ({"TriggerMode": "On"}, "On"), ([{"TriggerMode": "On"}], "On")]
)
def test_without_a_trigger_one_that_was_left_in_the_camera_is_ended(tmp_path, settings, mode):
    nodes = Nodes(**SCAN | {"TriggerSelector": "AcquisitionStart", "TriggerMode": "On"})
    nodes.TriggerSelector.symbolics = ["AcquisitionStart", "FrameStart"]
    faked(nodes, [], tmp_path, settings=settings).connect()
    assert nodes.TriggerMode.value == mode
    assert nodes.TriggerSelector.value == ("FrameStart" if mode == "Off" else "AcquisitionStart")


def test_off_of_a_yaml_file_is_a_word_where_the_feature_takes_words(tmp_path):
    nodes = Nodes(**SCAN | {"ExposureAuto": "Once", "ReverseX": True, "GainAuto": "Once"})
    nodes.ExposureAuto.symbolics = nodes.GainAuto.symbolics = ["Off", "On", "Once"]
    settings = {"ExposureAuto": False, "GainAuto": True, "ReverseX": False}
    driver = faked(nodes, [], tmp_path, settings=settings)
    driver.connect()
    assert (nodes.ExposureAuto.value, nodes.GainAuto.value, nodes.ReverseX.value) == ("Off", "On", False)
    driver.apply({"GainAuto": False})
    assert nodes.GainAuto.value == "Off"


def test_a_list_of_settings_writes_a_selector_again(tmp_path):
    class Selected(Nodes):
        enabled: ClassVar[list] = []

        def __setattr__(self, name, value):
            super().__setattr__(name, value)
            if name == "ComponentEnable":
                nodes = self
                kind = type("Enable", (), {"value": property(None, lambda _, on: nodes.enable(on))})
                self.__dict__[name] = kind()

        def enable(self, on):
            self.enabled.append((self.ComponentSelector.value, on))

    nodes = Selected(**SCAN | {"ComponentSelector": "", "ComponentEnable": False})
    parts = [{"ComponentSelector": part, "ComponentEnable": True} for part in ("Range", "Confidence")]
    faked(nodes, [], tmp_path, settings=parts).connect()
    assert nodes.enabled == [("Range", True), ("Confidence", True)]


def test_a_confidence_of_another_size_is_told_once_and_left_out(tmp_path, caplog):
    buffers = [Buffer(), Buffer()]
    for buffer in buffers:
        buffer.payload.components.append(component("Confidence8", np.zeros(4), 2, 2))
    driver = faked(Nodes(**SCAN), buffers, tmp_path)
    driver.connect()
    assert all(np.isfinite(frame.depth_m).all() for frame in islice(driver.frames(), 2))
    assert caplog.text.count("the confidence is (2, 2), the depth (3, 4): it is left out") == 1


def test_a_buffer_is_given_back_also_where_it_cannot_be_used(tmp_path):
    bad = Buffer()
    bad.payload.components.pop(0)
    driver = faked(Nodes(**SCAN), [bad], tmp_path)
    driver.connect()
    with pytest.raises(FeatureError, match="Mono16 4 x 3 and no coordinate C"):
        next(driver.frames())
    assert bad.queued == 1


def test_settings_are_written_in_their_order_at_each_connection(tmp_path):
    nodes = Nodes(**SCAN | {"ExposureTime": 1.0, "Gain": 0.0})
    driver = faked(nodes, [], tmp_path, settings={"ExposureTime": 500.0, "Gain": 2.0})
    driver.connect()
    driver.close()
    nodes.ExposureTime.value = 1.0
    driver.connect()
    assert (nodes.ExposureTime.value, nodes.Gain.value) == (500.0, 2.0)


def test_the_lens_may_be_given():
    lens = Camera(width=4, height=3, fx=9.0, fy=9.0, cx=1.0, cy=1.0)
    assert Scan3d(Nodes(**SCAN), lens).camera(4, 3).fx == 9.0


def test_features_change_while_it_runs_all_or_none(tmp_path):
    nodes = Nodes(**SCAN | {"ExposureTime": 1.0, "Gain": 0.0})
    driver = faked(nodes, [], tmp_path)
    driver.connect()
    assert driver.settings() == {"ExposureTime": 1.0, "Gain": 0.0}
    driver.apply({"ExposureTime": 500.0, "Width": 4})
    assert driver.settings() == {"ExposureTime": 500.0, "Gain": 0.0, "Width": 4}
    with pytest.raises(FeatureError, match="no feature 'Gamma'"):
        driver.apply({"Gain": 2.0, "Gamma": 1.0})
    assert nodes.Gain.value == 0.0


def test_frames_without_a_buffer_are_told_apart_from_those_that_the_link_lost(tmp_path):
    nodes = Nodes(**SCAN)
    driver = faked(nodes, [Buffer(number=1), Buffer(number=5)], tmp_path)
    driver.connect()
    assert all(islice(driver.frames(), 2))
    driver._acquirer.underruns = 1
    assert driver.drops() == (2, 1)
    driver.close()
    assert driver.drops() == (2, 1)
