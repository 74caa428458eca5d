"""``--world``: campaigns emulate other physics, and no method is told."""

from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError

from rpod.scenarios import find, shipped
from rpod_campaign.catalogue import BUILT_IN
from rpod_campaign.catalogue import find as find_campaign
from rpod_campaign.lidar_acceptance import trial as lidar_acceptance
from rpod_campaign.lidar_acceptance.trial import AcceptanceCell
from rpod_campaign.lidar_acquisition import trial as lidar
from rpod_campaign.pmd.scene import Stage, scenario_of
from rpod_campaign.pmd.world import World

TWO = ("documented", "noisy")
OWN_CELLS = [name for name in BUILT_IN if name != "model-matrix"]  # that one has the population's
SCENARIOS = {name: find(name) for name in shipped()}


def cells(name, **options):
    campaign = find_campaign(name)
    provided = {"scenarios": SCENARIOS} if "scenarios" in campaign.options.model_fields else {}
    return list(campaign.cells(campaign.options(**provided, **options)))


@pytest.mark.parametrize("name", OWN_CELLS)
def test_every_campaign_has_cells_in_each_world(name):
    one, both = cells(name, world=TWO[:1]), cells(name, world=TWO)
    papers = 34 if name == "pmd-tracking" else 0  # Table 2 of the paper is of the documented world alone
    assert len(one) < len(both) <= 2 * len(one)
    assert 2 * len(one) - len(both) <= papers
    assert len(set(both)) == len(both)


def test_an_unknown_world_is_refused():
    with pytest.raises(ValidationError, match="stray-light"):
        cells("lidar-acquisition", world=("mars",))


def test_a_scan_of_another_world_is_another_and_the_method_is_the_same():
    cell, *_ = cells("lidar-acquisition", method=("global",), ranges=(30.0,))
    ours, theirs = lidar.run(cell, 1, 0), lidar.run(replace(cell, world="noisy"), 1, 0)
    assert ours["truth"] == theirs["truth"]
    assert ours["found"] != theirs["found"]


@pytest.mark.parametrize("range_m", [20.0, 40.0])
def test_a_small_body_is_not_taken_for_the_nearest_face_of_a_large_one(range_m):
    """Were the sensor's power anybody's guess, all that lies behind that face could be too dim to be seen."""
    names = {"target": "envisat-slim", "scanned_target": "hexagonal-body", "method": "global"}
    cell = AcceptanceCell(**names, step_deg=None, range_m=range_m)
    assert not any(lidar_acceptance.run(cell, 71, trial)["accepted"] for trial in range(6))


def test_a_frame_of_another_world_is_another_and_the_pose_is_the_same():
    documents = [cell.document for cell in cells("pmd-acquisition", case=("all",), world=TWO)]
    stages = [Stage(scenario_of(document), World(), seed=1, trial=0) for document in documents]
    frames = [stage.take(0.0).frame for stage in stages]
    assert not np.array_equal(frames[0].depth_m, frames[1].depth_m, equal_nan=True)
    np.testing.assert_array_equal(*(stage.truth(0.0).as_matrix() for stage in stages))
