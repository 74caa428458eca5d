"""The whole check: a pure function from the observations of a sensor to one verdict a line."""

from rpod_driver.check import content, delivery, geometry, plane, second_sensor, setup, stamps
from rpod_driver.check.observations import Observations
from rpod_driver.check.verdict import Verdict


def judge(seen: Observations) -> list[Verdict]:
    """Return one verdict a line, in the order of the catalogue."""
    verdicts = [
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
        content.unit(seen),
        setup.mount(seen),
        second_sensor.mount_second(seen),
        setup.qos(seen),
        setup.instant(seen),
        setup.grid(seen),
    ]
    if seen.kind == "pmd":
        verdicts += [
            content.values(seen),
            content.saturation(seen),
            plane.depth_model(seen),
            setup.lens(seen),
        ]
    if seen.kind == "lidar":
        verdicts += [setup.axes(seen), setup.point_times(seen)]
    return geometry.with_truth(seen, verdicts)
