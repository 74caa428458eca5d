import pytest

from rpod_runtime.errors import RefusedError
from rpod_runtime.ros.parameters import Parameters, flatten

DOCUMENT = {
    "instance": "estimator",
    "bus": {"domain": 3, "wait": False},
    "sensors": [{"name": "pmd", "rate_hz": 45.0}, {"name": "lidar", "rate_hz": 1}],
    "mount_m": [0, 0.5, 1],
    "limits": [1, 2],
    "names": ["a", "b"],
    "none": None,
    "empty": [],
    "nothing": {},
    "mixed": ["a", 1],
    "huge": 2**63,
}


def test_a_configuration_becomes_names_with_dots_and_values_of_one_type():
    assert dict(flatten(DOCUMENT)) == {
        "instance": "estimator",
        "bus.domain": 3,
        "bus.wait": False,
        "sensors.0.name": "pmd",
        "sensors.0.rate_hz": 45.0,
        "sensors.1.name": "lidar",
        "sensors.1.rate_hz": 1,
        "mount_m": [0.0, 0.5, 1.0],
        "limits": [1, 2],
        "names": ["a", "b"],
        "none": None,
        "empty": [],
        "mixed.0": "a",
        "mixed.1": 1,
        "huge": str(2**63),
    }
    assert all(isinstance(each, float) for each in dict(flatten(DOCUMENT))["mount_m"])


@pytest.mark.parametrize(
    ("prefixes", "depth", "names"),
    [
        ([], 1, ["empty", "huge", "instance", "limits", "mount_m", "names", "none"]),
        (["bus"], 0, ["bus.domain", "bus.wait"]),
        (["sensors"], 1, []),
        (["sensors"], 2, ["sensors.0.name", "sensors.0.rate_hz", "sensors.1.name", "sensors.1.rate_hz"]),
        (["sensors.1", "bus.wait"], 1, ["bus.wait", "sensors.1.name", "sensors.1.rate_hz"]),
        (["bu"], 0, []),
    ],
)
def test_names_are_listed_by_prefix_and_depth_as_ros_does(prefixes, depth, names):
    assert Parameters(DOCUMENT).listed(prefixes, depth)[0] == names


def test_prefixes_of_the_listed_names_are_told_once():
    assert Parameters(DOCUMENT).listed(["sensors"], 0)[1] == ["sensors.0", "sensors.1"]


def test_what_was_set_before_a_refusal_is_taken_back():
    parameters, rates, told = Parameters({}), [], []

    def refuse(_: float) -> None:
        raise ValueError("is at most 45, the camera's fastest")

    parameters.offer("rate_hz", 5.0, rates.append)
    parameters.offer("other_hz", 5.0, refuse)
    parameters.on_change(told.append)
    with pytest.raises(RefusedError, match="other_hz: is at most 45"):
        parameters.set([("rate_hz", 9.0), ("other_hz", 50.0)])
    assert rates == [9.0, 5.0]
    assert (parameters.value("rate_hz"), told) == (5.0, [])


def test_an_offered_parameter_takes_the_place_of_the_configurations():
    parameters, values = Parameters({"rate_hz": 5.0}), []
    with pytest.raises(RefusedError, match="cannot change while the service runs"):
        parameters.set([("rate_hz", 6.0)])
    parameters.offer("rate_hz", 5.0, values.append)
    parameters.set([("rate_hz", 6.0)])
    assert (values, parameters.value("rate_hz"), parameters.names()) == ([6.0], 6.0, ["rate_hz"])


def test_a_value_that_was_read_again_can_still_be_set():
    parameters = Parameters(DOCUMENT)
    parameters.offer("log_level", "info", lambda _: None, description="what is logged")
    parameters.renew("log_level", "debug")
    parameters.renew("new", 3)
    assert [parameters.value(name) for name in ("log_level", "new")] == ["debug", 3]
    parameters.set([("log_level", "info")])
    assert parameters.value("log_level") == "info"
