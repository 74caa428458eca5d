"""A nearly round target, whose parts in view look alike at several turns about its axis."""

import numpy as np
from pmd_frames import depth_frame
from scipy.spatial.transform import Rotation

from rpod_pose.pmd.fit import PmdFitter
from rpod_pose.pmd.frame_search import FrameSearch, Model
from rpod_pose.pmd.scene import scene_of
from rpod_pose.registration.lie_group import PoseArrays
from rpod_schemas.config.pmd.search import PmdAcquisitionTuning
from rpod_schemas.poses import make_pose
from rpod_target import load_target

DRUM = """
name: drum
mass_kg: 80
materials: {plain: {reflectivity: 0.4, diffuse: 0.4, f0: 0.02, roughness: 0.3}}
distance_field: {spacing_m: 0.06}
model_points: 500
parts:
  - {name: drum, shape: cylinder, radius_m: 0.6, length_m: 1.0, material: plain}
  - {name: horn, shape: box, size_m: [0.5, 0.3, 0.4], material: plain,
     T_target_part: {translation_m: [0.1, 0.05, 0.7]}}
"""
THRUSTER = """
  - {{name: thruster{0}, shape: box, size_m: [0.2, 0.2, 0.2], material: plain,
     T_target_part: {{translation_m: [{1}, {2}, -0.3], euler_321_deg: [{0}, 0, 0]}}}}
"""


def turned(angle_deg):
    return Rotation.from_euler("z", angle_deg, degrees=True)


def test_turns_about_the_axis_of_a_drum_are_tried_where_parts_look_alike(tmp_path):
    """From below, thrusters at 0 and 40 deg look as those at 40 and 80 deg do."""
    places = [
        (angle, *(0.7 * np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])))
        for angle in (0, 40, 80)
    ]
    file = tmp_path / "drum.yaml"
    file.write_text(DRUM + "".join(THRUSTER.format(*place).lstrip("\n") for place in places))
    target = load_target(file, cache=tmp_path)
    below = Rotation.from_euler("x", 25.0, degrees=True)
    truth = make_pose(rotation=below, translation_m=(0.0, 0.0, 3.0))
    tuning, model = PmdAcquisitionTuning(), Model.of(target, PmdAcquisitionTuning())
    scene = scene_of(depth_frame(target, truth), tuning.scene, radius_m=target.radius_m)
    shape = PmdFitter(tuning.model, model.shown, scene, known_materials=False)
    search = FrameSearch(tuning, model, scene, shape, lambda _: True)
    found = PoseArrays((below * turned(40.0)).as_matrix(), truth.translation)

    def none(attitudes):
        return np.zeros(len(attitudes), bool)

    poses = search.turned(found, none, shape, np.inf)
    off = [np.degrees((truth.rotation.inv() * Rotation.from_matrix(pose.R)).magnitude()) for pose in poses]
    assert min(off) < 4.0
    assert not search.turned(found, none, shape, 0.0)
    assert not search.turned(found, lambda attitudes: ~none(attitudes), shape, np.inf)
