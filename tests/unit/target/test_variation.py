"""Variations of a target, by the terms behind its name."""

from dataclasses import replace

import numpy as np
import pytest

from rpod_schemas.errors import ConfigurationError
from rpod_target import TargetError, check_model, load_target
from rpod_target.variation import Variation, split

BODY = {"shape": "box", "size_m": [1.0, 1.0, 1.0]}
ARM = {
    "shape": "box",
    "size_m": [2.0, 0.1, 0.1],
    "T_target_part": {"translation_m": [1.5, 0.0, 0.0]},
}


@pytest.fixture
def vary(build, cache):
    def vary(terms):
        return load_target(build(BODY, ARM).source + terms, cache=cache)

    return vary


def corners(target):
    return target.triangles_m.reshape(-1, 3)


def test_a_bent_end_keeps_the_body_and_turns_about_its_root(vary):
    bent = vary("@bent=5deg")
    assert np.abs(corners(bent)[:, 1:]).max() == pytest.approx(0.5)  # of the body
    tip = np.unique(corners(bent)[corners(bent)[:, 0] > 1.5], axis=0).mean(axis=0)
    root = np.array([0.5, 0.0, 0.0])  # the first cut beyond it is at most a thirtieth of the reach away
    turned = np.rad2deg(np.arctan2(np.linalg.norm((tip - root)[1:]), (tip - root)[0]))
    assert turned == pytest.approx(5.0, abs=0.6)


def test_a_missing_end_leaves_a_closed_body(vary):
    missing = vary("@missing")
    assert corners(missing)[:, 0].max() < 0.75
    assert missing.repairs == ()
    assert missing.field is not None
    assert missing.field.values.min() == pytest.approx(-0.5, abs=0.06)


def test_scale_and_displacement_are_as_large_as_they_say(vary):
    plain, larger, off = vary(""), vary("@scale=-2%"), vary("@off=3mm@seed=2")
    assert np.allclose(corners(larger), 0.98 * corners(plain))
    displacement = np.linalg.norm(corners(off) - corners(plain), axis=1)
    assert 1e-3 < np.sqrt((displacement**2).mean()) < 6e-3
    assert not np.allclose(corners(off), corners(vary("@off=3mm@seed=3")))


def test_a_coarse_model_has_fewer_triangles_and_named_parts_are_left_out(build, cache):
    pipe = {"shape": "cylinder", "radius_m": 0.5, "length_m": 2.0}
    source = build(BODY, pipe).source
    coarse = load_target(f"{source}@coarse=4%", cache=cache)
    assert 12 < len(coarse.triangles_m) < 60
    assert load_target(f"{source}@without=part-1", cache=cache).parts == ("part-0",)


def test_a_variation_has_a_name_a_source_and_a_digest_of_its_own(vary):
    plain, bent = vary(""), vary("@bent=5deg")
    assert (plain.name, bent.name) == ("brick", "brick@bent=5deg")
    assert bent.source == f"{plain.source}@bent=5deg"
    assert len({plain.digest, bent.digest, vary("@bent=5deg@seed=2").digest}) == 3


def test_wrong_terms_are_refused_with_the_field_and_the_remedy(vary):
    with pytest.raises(ConfigurationError, match=r"bent.*needs a number with its unit \(deg\), not '5'"):
        vary("@bent=5")
    with pytest.raises(ConfigurationError, match=r"bend.*not a known field"):
        vary("@bend=5deg")
    with pytest.raises(TargetError, match="part 'nose' is unknown; known are part-0, part-1"):
        vary("@without=nose")


def test_only_terms_at_the_end_of_a_name_are_a_variation():
    assert split("/home/me@work/body.yaml") == ("/home/me@work/body.yaml", {})
    base, terms = split("mockup@without=a@without=b@missing@scale=1.5%")
    assert base == "mockup"
    assert Variation(**terms) == Variation(without=("a", "b"), missing=True, scale=0.015)


def test_a_model_shares_the_axes_of_its_target_or_the_error_tells_how_they_differ(vary):
    truth = vary("")
    for terms in ("@missing", "@bent=5deg", "@scale=3%", "@off=20mm"):
        check_model(truth, vary(terms))
    elsewhere = replace(
        truth, digest="other", model_points_m=truth.model_points_m + np.array((0.0, 0.2, 0.0))
    )
    with pytest.raises(TargetError, match=r"axes of brick.*euler_321_deg \[0, 0, 0\].*moved by \[.*-0\.2,"):
        check_model(truth, elsewhere)
