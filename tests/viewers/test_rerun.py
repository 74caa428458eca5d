"""What Rerun's importer makes of the facility's logs to be seen."""

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rpod_analysis import open_log
from rpod_schemas.messages import read_camera, read_points, read_transforms
from rpod_schemas.topics import AMPLITUDE, CAMERA_INFO, DEPTH, PHASE, POINTS, TF, TF_STATIC, Topic

pytestmark = pytest.mark.needs("rerun")
DEPTH_TOPIC, AMPLITUDE_TOPIC, PHASE_TOPIC = (topic.of("pmd") for topic in (DEPTH, AMPLITUDE, PHASE))
INFO_TOPIC, POINTS_TOPIC = CAMERA_INFO.of("pmd"), POINTS.of("lidar")


@pytest.fixture(scope="module")
def shown(every_sensor) -> dict[tuple[str, str], list[Any]]:
    """What the viewer gets: values of each message by entity and component, in the order of the log."""
    from rerun.chunk import McapReader  # noqa: PLC0415 - it may not be there

    components: dict[tuple[str, str], list[Any]] = defaultdict(list)
    for chunk in McapReader(every_sensor).stream():
        rows = chunk.to_record_batch()
        for name in rows.schema.names:
            components[chunk.entity_path, name] += list(rows[name]) if ":" in name else []
    return components


def logged(path: Path, topic: Topic) -> list[Any]:
    with open_log(path) as log:
        return [item.decode() for item in log.messages(topic)]


@pytest.mark.parametrize("topic", [DEPTH_TOPIC, AMPLITUDE_TOPIC], ids=lambda topic: topic.name)
def test_images_are_pictures_of_the_same_size_and_bytes(shown, every_sensor, topic):
    expected = logged(every_sensor, topic)
    formats = [row[0].as_py() for row in shown[f"/{topic.name}", "DepthImage:format"]]
    assert [(size["width"], size["height"]) for size in formats] == [(m.width, m.height) for m in expected]
    for row, message in zip(shown[f"/{topic.name}", "DepthImage:buffer"], expected, strict=True):
        np.testing.assert_array_equal(row[0].values.to_numpy(), message.data)


def test_the_camera_is_a_pinhole_of_the_same_intrinsics(shown, every_sensor):
    matrices = shown[f"/{INFO_TOPIC.name}", "Pinhole:image_from_camera"]
    cameras = [read_camera(message) for message in logged(every_sensor, INFO_TOPIC)]
    for row, camera in zip(matrices, cameras, strict=True):
        fx, _, _, _, fy, _, cx, cy, _ = row[0].as_py()  # column by column
        assert (fx, fy, cx, cy) == pytest.approx((camera.fx, camera.fy, camera.cx, camera.cy))


def test_a_scan_is_a_cloud_of_the_same_points(shown, every_sensor):
    scans = [read_points(message) for message in logged(every_sensor, POINTS_TOPIC)]
    for cloud, scan in zip(shown[f"/{POINTS_TOPIC.name}", "Points3D:positions"], scans, strict=True):
        points_m = cloud.values.flatten().to_numpy().reshape(-1, 3)
        np.testing.assert_array_equal(points_m, np.stack([scan[axis].ravel() for axis in "xyz"], axis=1))


@pytest.mark.parametrize("topic", [TF, TF_STATIC], ids=lambda topic: topic.name)
def test_transforms_have_the_same_frames_and_places(shown, every_sensor, topic):
    expected = [entry for message in logged(every_sensor, topic) for entry in read_transforms(message)]
    parents, children, places_m = (
        [row[0].as_py() for row in shown[f"/{topic.name}", f"Transform3D:{part}"]]
        for part in ("parent_frame", "child_frame", "translation")
    )
    assert list(zip(parents, children, strict=True)) == [(parent, child) for _, parent, child, _ in expected]
    np.testing.assert_allclose(places_m, [pose.translation for *_, pose in expected], rtol=1e-6)


def test_raw_samples_alone_are_no_picture(shown):
    """Rerun draws no image of four channels that are not colours (16UC4); it says so and shows the rest."""
    assert shown[f"/{PHASE_TOPIC.name}", "CoordinateFrame:frame"]
    assert not shown[f"/{PHASE_TOPIC.name}", "DepthImage:buffer"]
    assert not shown[f"/{PHASE_TOPIC.name}", "Image:buffer"]
