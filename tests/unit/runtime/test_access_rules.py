from rpod_runtime.session import truth_rules
from rpod_schemas.config.service import BusConfig, RouterConfig
from rpod_schemas.topics import REFERENCE, TF, TRUTH, Namespace


def test_the_rules_name_every_form_of_the_truth_with_its_caches():
    config = RouterConfig(bus=BusConfig(domain=4, namespace="lab"))
    (rule,) = truth_rules(config)["rules"]
    for topic in (TRUTH, REFERENCE, TF):
        assert f"4/lab/{topic.name}/**" in rule["key_exprs"]
        assert f"4/lab/{topic.name}/**/@adv/**" in rule["key_exprs"]
    assert rule["permission"] == "deny"
    assert Namespace(4, "lab").key(TRUTH).startswith("4/lab/truth/odometry/")


def test_the_rules_hold_for_every_named_estimator():
    (subject,) = truth_rules(RouterConfig(estimators=("a1", "b2")))["subjects"]
    assert subject["zids"] == ["a1", "b2"]


def test_without_estimators_there_are_no_rules():
    assert not truth_rules(RouterConfig(estimators=()))["enabled"]
