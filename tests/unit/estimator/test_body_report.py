"""What an operator, and later a reader of the log, is told of a known body that sensors see elsewhere."""

from types import SimpleNamespace

import numpy as np

from rpod_analysis.log.accounting import Account
from rpod_estimator.inputs.bodies import BodyReport
from rpod_pose.surroundings.bodies import KnownBodies
from rpod_pose.surroundings.body_check import FRAMES, BodyState, Sighting
from rpod_runtime.health import HealthBook
from rpod_schemas.types import Health

TOPIC = "estimate/status"


def test_a_body_seen_elsewhere_is_told_counted_and_in_the_summary_and_one_in_its_place_again_is_no_alarm():
    bodies, health, account = KnownBodies(()), HealthBook("estimator"), Account()
    report = BodyReport(SimpleNamespace(health=health), bodies)
    health.put(f"published/{TOPIC}", 1)
    health.report(Health.OK, "tracking")

    def show(state: BodyState, offset_m=None) -> None:
        for _ in range(FRAMES):
            seen = Sighting("arm", state, 0.05, 100, 100 * (state is BodyState.IN_PLACE), 0, offset_m)
            bodies.book.take("pmd", seen, np.eye(3))
        report.update()
        account.take_diagnostic(health.diagnostic(0))

    show(BodyState.ELSEWHERE, np.array([0.3, 0.0, 0.4]))
    found = health.diagnostic(0)
    assert found.level == Health.WARN
    assert found.message == "tracking; look at body/arm/pmd"
    assert "pmd sees the known body arm 0.50 m away from its pose" in found.values["body/arm/pmd"]
    show(BodyState.IN_PLACE)
    assert health.diagnostic(0).level == Health.OK
    show(BodyState.UNSEEN)
    assert health.diagnostic(0).level == Health.OK
    assert "100 of 100 rays on it have no range" in health.diagnostic(0).values["body/arm/pmd"]
    (account_of_arm,) = account.bodies(TOPIC)["arm"].values()
    assert account_of_arm.model_dump(exclude={"last"}) == {
        "in_place": FRAMES, "elsewhere": FRAMES, "unseen": FRAMES, "hidden": 0,
    }  # fmt: skip
    assert "its pose is not checked" in account_of_arm.last
    assert account.bodies("other/status") == {}
