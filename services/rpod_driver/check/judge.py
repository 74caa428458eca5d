"""The whole check: a pure function from the observations of a sensor to one result a line."""

from rpod_driver.check import content, delivery, geometry, second_sensor, setup, stamps
from rpod_driver.check.kinds import checks_of
from rpod_driver.check.observations import Observations
from rpod_driver.check.result import CheckResult


def judge(seen: Observations) -> list[CheckResult]:
    """Return one result a line, in the order of the catalogue."""
    checks = checks_of(seen.kind)
    results = [
        delivery.publisher(seen),
        delivery.rate(seen),
        delivery.gaps(seen),
        delivery.bus(seen),
        delivery.parts(seen),
        stamps.clock(seen),
        stamps.drift(seen),
        stamps.order(seen),
        stamps.jitter(seen),
        content.content(seen),
        content.frozen(seen),
        content.returns(seen),
        content.partial(seen),
        content.unit(seen, farthest_m=checks.farthest_m, why=checks.why),
        setup.mount(seen),
        second_sensor.mount_second(seen),
        setup.qos(seen),
        setup.instant(seen),
        *(line(seen) for line in checks.lines),
    ]
    return geometry.with_truth(seen, results)
