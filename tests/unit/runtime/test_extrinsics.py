import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rpod_runtime.errors import ExtrinsicsError
from rpod_runtime.sensor_data.extrinsics import Extrinsics
from rpod_schemas.poses import make_pose

T_CHASER_PLATE = make_pose(
    rotation=Rotation.from_rotvec([0.0, 0.0, np.pi / 2]), translation_m=[1.0, 0.0, 0.0]
)
T_PLATE_PMD = make_pose(rotation=Rotation.from_rotvec([0.1, 0.0, 0.0]), translation_m=[0.0, 0.2, 0.0])


def assert_same(one, other):
    np.testing.assert_allclose(one.as_matrix(), other.as_matrix(), atol=1e-12)


def test_a_mount_is_the_product_along_the_chain_to_the_chaser():
    extrinsics = Extrinsics({"pmd": None})
    extrinsics.set("plate", "pmd_optical", T_PLATE_PMD)
    extrinsics.set("chaser", "plate", T_CHASER_PLATE)
    mount = extrinsics.mount("pmd", "pmd_optical")
    assert_same(mount, T_CHASER_PLATE * T_PLATE_PMD)
    np.testing.assert_allclose(mount.apply([0.0, 0.0, 0.0]), [0.8, 0.0, 0.0], atol=1e-12)


def test_measurements_in_chaser_axes_need_no_transform():
    assert_same(Extrinsics({}).mount("pmd", "chaser"), make_pose())


def test_a_later_transform_replaces_an_earlier_one():
    extrinsics = Extrinsics({"pmd": None})
    extrinsics.set("chaser", "pmd_optical", T_CHASER_PLATE)
    extrinsics.set("chaser", "pmd_optical", T_PLATE_PMD)
    assert_same(extrinsics.mount("pmd", "pmd_optical"), T_PLATE_PMD)


@pytest.mark.parametrize(
    "transforms",
    [
        [],
        [("plate", "pmd_optical")],
        [("chaser", "other")],
        [("plate", "pmd_optical"), ("pmd_optical", "plate")],
        [("pmd_optical", "pmd_optical")],
    ],
    ids=["nothing", "a chain that ends elsewhere", "another sensor's", "a loop", "a frame in itself"],
)
def test_without_a_chain_the_mount_comes_from_the_configuration(transforms):
    configured, unknown = Extrinsics({"pmd": T_CHASER_PLATE}), Extrinsics({"pmd": None})
    for parent, child in transforms:
        configured.set(parent, child, T_PLATE_PMD)
        unknown.set(parent, child, T_PLATE_PMD)
    assert_same(configured.mount("pmd", "pmd_optical"), T_CHASER_PLATE)
    with pytest.raises(ExtrinsicsError, match=r"no chain from 'pmd_optical' to 'chaser'.*tf_static"):
        unknown.mount("pmd", "pmd_optical")


@pytest.mark.parametrize(
    ("frame_id", "told"),
    [
        ("/cam", r"but one from 'cam': let the driver leave out the slash"),
        ("", r"the frame_id is empty; let the driver set header\.frame_id"),
        ("lens", r"it ends at 'table'; publish it on tf_static \(tf itself is not read\).* of the whole"),
        (
            "camera",
            r"tf itself is not read\), or configure T_chaser_sensor; tf_static has arm, cam, lens, robot",
        ),
    ],
)
def test_a_frame_without_a_chain_is_told_with_what_is_known(frame_id, told):
    extrinsics = Extrinsics({"pmd": None})
    for parent, child in (("chaser", "arm"), ("arm", "cam"), ("table", "robot"), ("robot", "lens")):
        extrinsics.set(parent, child, T_PLATE_PMD)
    with pytest.raises(ExtrinsicsError, match=told):
        extrinsics.mount("pmd", frame_id)


def test_a_sensor_that_nobody_told_of_has_no_mount():
    with pytest.raises(ExtrinsicsError):
        Extrinsics({}).mount("pmd", "pmd_optical")


def test_both_sources_may_speak_where_they_agree():
    extrinsics = Extrinsics({"pmd": T_CHASER_PLATE})
    rounded = make_pose(
        rotation=T_CHASER_PLATE.rotation * Rotation.from_rotvec([5e-5, 0.0, 0.0]),
        translation_m=T_CHASER_PLATE.translation + 5e-5,
    )
    extrinsics.set("chaser", "pmd_optical", rounded)
    assert_same(extrinsics.mount("pmd", "pmd_optical"), rounded)


@pytest.mark.parametrize(
    ("shift_m", "turn_rad"),
    [([2e-4, 0, 0], [0, 0, 0]), ([0, 0, 0], [0, 2e-4, 0]), ([0, 0, 0], [0, 0, np.pi])],
)
def test_where_both_speak_and_differ_it_is_an_error(shift_m, turn_rad):
    extrinsics = Extrinsics({"pmd": T_CHASER_PLATE})
    other = T_CHASER_PLATE * make_pose(rotation=Rotation.from_rotvec(turn_rad), translation_m=shift_m)
    extrinsics.set("chaser", "pmd_optical", other)
    with pytest.raises(ExtrinsicsError, match="tf_static and the configured T_chaser_sensor of 'pmd' differ"):
        extrinsics.mount("pmd", "pmd_optical")
