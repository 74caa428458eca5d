from rpod_runtime.bus.session import truth_rules
from rpod_schemas.config.service import RouterConfig
from rpod_schemas.topics import REFERENCE, TF, TRUTH


def test_the_rules_name_every_form_of_the_truth_with_its_caches():
    (rule,) = truth_rules(RouterConfig())["rules"]
    for topic in (TRUTH, REFERENCE, TF):
        assert f"*/**/{topic.name}/**" in rule["key_exprs"]
        assert f"*/**/{topic.name}/**/@adv/**" in rule["key_exprs"]
    assert rule["permission"] == "deny"


def test_the_rules_hold_for_every_named_estimator():
    (subject,) = truth_rules(RouterConfig(estimators=("a1", "b2")))["subjects"]
    assert subject["zids"][:2] == ["a1", "b2"]
    assert {"a1000", "a13ff", "b22bc"} <= set(subject["zids"]), "each start has an identity of its own"


def test_without_estimators_there_are_no_rules():
    assert not truth_rules(RouterConfig(estimators=()))["enabled"]
