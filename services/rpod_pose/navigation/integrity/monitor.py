"""The integrity monitor: a pure function from the navigator's state to protection levels, state and reason.

``assess(memory, state, output) -> (memory, integrity)`` is called once after each step of the navigator. It
reads the navigator's state and output, and changes neither. The memory holds data that the navigator does not
keep: filters without one of several sensors, residuals of each sensor, and earlier estimates.

An alert means that measurements contradict each other, or that the estimate contradicts an earlier one. It
does not say which of them is wrong. An error that all measurements of a single sensor share contradicts
nothing: a wrong mount, a clock's offset at constant speed, a slow drift of ranges. The levels include the
standard deviation that the configuration declares for such an error.
"""

from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations

import numpy as np

from rpod_pose.navigation.filter import FilterState, gate_nis, predict
from rpod_pose.navigation.history import Step, after
from rpod_pose.navigation.integrity.clock_frames import TwoClocks, apart_of, two_clocks
from rpod_pose.navigation.integrity.clocks import Pair, mount_test
from rpod_pose.navigation.integrity.declared_states import declared_tests
from rpod_pose.navigation.integrity.levels import (
    Levels,
    LevelsOf,
    above,
    declared_covariance,
    solution,
)
from rpod_pose.navigation.integrity.memory import Memory
from rpod_pose.navigation.integrity.mounts import mount_offsets
from rpod_pose.navigation.integrity.older import older_solutions, rival_solutions
from rpod_pose.navigation.integrity.refused import refused_solutions, turning_solutions
from rpod_pose.navigation.integrity.residuals import (
    Statistic,
    lasting_errors,
    residual_of,
    residual_tests,
    separation_test,
)
from rpod_pose.navigation.integrity.sizes import SizedFilters, shifts_of, sized_after
from rpod_pose.navigation.pose_measurement import PoseMeasurement, alone_of, compared, started
from rpod_pose.navigation.state import Cause, NavigatorState, Output
from rpod_schemas.config.estimator import EstimatorSettings
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.config.sensor import AlertLimit
from rpod_schemas.types import BeliefLevel, Integrity, IntegrityState, Mode

DECLARED_ONLY = "errors of mount, clock and ranges are covered as far as declared, not beyond"
"""Limit of the levels if one of several sensors alone is not accurate enough for the alert limits."""
SIZE_BELIEVED = (
    "the size of the target is taken from its file unchecked; to have it checked, calibrate the camera"
)
"""Limit of the levels if a camera's distances alone are not accurate enough for the alert limits."""
SIZE_DECLARED = (
    "size errors up to 2 % cannot be detected; they are covered as far as the target's scale_tolerance states"
)
"""Limit of the levels if they are above the alert limits with the sizes that no frame can exclude."""


class Monitor:
    """Checks the integrity of each output of the navigator.

    Args:
        settings: settings of the estimator.
    """

    def __init__(self, settings: EstimatorSettings) -> None:
        self._filter, self._config = settings.filter, settings.integrity
        self._tuning, self._silence_s = settings.integrity.tuning, settings.navigator.silence_timeout_s
        self._limits = {sensor.name: sensor.alert_limit for sensor in settings.sensors}

    def assess(
        self, memory: Memory, state: NavigatorState, output: Output, *, frozen: bool = False
    ) -> tuple[Memory, Integrity]:
        """Return the memory after a step of the navigator, and the integrity of its output.

        Args:
            memory: the memory before.
            state: the navigator's state after the step.
            output: what the step publishes.
            frozen: whether the step's frame was refused because it is identical to the frames before.
        """
        memory = self._heard(memory, state, output, frozen)
        if not state.mode.has_track or state.history is None:
            memory = replace(memory, sized={})
            reason = f"the target is not tracked: {state.mode.name}"
            stamp_ns = output.status.stamp_ns
            return memory, self._integrity(output, stamp_ns, IntegrityState.UNAVAILABLE, reason)
        newest = state.history.state
        shown_ns = state.shown_ns if output.odometry is None else output.odometry.stamp_ns
        estimate = predict(newest, max(newest.stamp_ns, shown_ns), self._filter)
        clocks = self._clocks(memory, estimate)
        memory = replace(memory, clocks=clocks)
        tests, evidence = self._tests(memory, estimate, clocks)
        memory = self._remembered(memory, state, estimate)
        limit = self._limit(memory, state, estimate)
        levels, less = self._levels(memory, state, output, estimate, limit=limit, clocks=clocks)
        checked = self._checked(
            memory, output, estimate, limit, tests=tests, levels=levels, less=less, evidence=evidence
        )
        return memory, checked

    # --- memory ---

    def _heard(self, memory: Memory, state: NavigatorState, output: Output, frozen: bool) -> Memory:
        """Return the memory with the frame of a step."""
        status, lasts = output.status, {"silence_s": self._silence_s, "memory_s": self._tuning.memory_s}
        memory = replace(memory, wrong=memory.wrong.after(state, status, frozen=frozen, **lasts))
        if status.accepted:
            frames = memory.frames.after(
                status.sensor, status.stamp_ns, output.measured, self._tuning.memory_s
            )
            memory = replace(memory, sensor=status.sensor, frames=frames)
        step = output.compared
        if step is None and state.history is not None and np.isfinite(status.nis):
            step = state.history.applied_at(status.stamp_ns, status.sensor)
        return memory if step is None else self._measured(memory, state, status.sensor, step)

    def _measured(self, memory: Memory, state: NavigatorState, sensor: str, step: Step) -> Memory:
        """Return the memory with a measurement that the filter has compared with its prediction."""
        predicted, measured = step.predicted, step.measurement
        if measured.origin is not None:
            memory = replace(memory, mounts={**memory.mounts, sensor: measured.origin.T_chaser_sensor})
        found = step.outcome.innovation
        if measured.declared is not None:  # the tests have declared errors of their own
            found = compared(predicted, replace(measured, declared=None), self._filter)
        lasting = lasting_errors(predicted, found, self._config)
        residual = residual_of(predicted, found, measured.stamp_ns, lasting)
        if residual is not None:
            memory = memory.with_residual(sensor, residual, self._tuning.window_s)
        before = memory.former_at(sensor, measured.stamp_ns) if sensor == memory.slow else None
        known = step.outcome.accepted or (
            residual is not None and residual.delayed_square() <= gate_nis(predicted, self._filter)
        )
        if before is not None and known:
            apart = apart_of(step, *before, self._filter)
            memory = memory.with_apart(sensor, apart, self._tuning.memory_s)
        without = self._without(memory, state, sensor, predicted, measured)
        sized: SizedFilters = {}
        if len(memory.residuals) < 2:
            sized = sized_after(memory.sized, memory.frames.newest_sizes(sensor), step, self._filter)
        return replace(memory.with_filters(without, self._filter.max_delay_s), sized=sized)

    def _without(
        self,
        memory: Memory,
        state: NavigatorState,
        sensor: str,
        predicted: FilterState,
        measured: PoseMeasurement,
    ) -> Mapping[str, FilterState]:
        """Return the filters without one sensor after a measurement of ``sensor``; none for one sensor.

        A filter without a newcomer begins with the track that has not used its frames. In the filter of a
        newcomer alone, its frames do not differ from a track of another sensor.
        """
        if len(memory.residuals) < 2:
            return {}
        measured = replace(measured, declared=None)
        found = {name: each for name, each in memory.without.items() if name in memory.residuals}
        for name in memory.residuals:
            alone = _without_newcomers(state, name, measured.stamp_ns, self._filter)
            if name == sensor:
                found.setdefault(name, alone or predicted)
            elif name not in found:
                found[name] = alone or started(
                    measured, config=self._filter, centre_of_mass_m=predicted.centre_of_mass_m,
                    alike=predicted.alike, blocks=alone_of(predicted.blocks),
                    model=predicted.model,
                )  # fmt: skip
            elif measured.stamp_ns >= found[name].stamp_ns:
                found[name] = after(found[name], measured, self._filter)
        return found

    def _remembered(self, memory: Memory, state: NavigatorState, estimate: FilterState) -> Memory:
        """Return the memory with an estimate that frames support compared with its past."""
        if state.mode is Mode.COASTING:  # a prediction contradicts nothing
            return memory
        past = memory.past.compared(
            estimate, unseen_ns=state.unseen_ns, config=self._config, filtered=self._filter
        )
        return replace(memory, past=past)

    # --- tests and levels ---

    def _tests(
        self, memory: Memory, estimate: FilterState, clocks: TwoClocks | None
    ) -> tuple[list[Statistic], dict[str, float]]:
        tests: list[Statistic] = []
        evidence: dict[str, float] = {}
        dof, period_s = estimate.alike.dof, self._tuning.correlated_s
        several = len(memory.residuals) > 1
        for name, residuals in memory.residuals.items():
            found, numbers = residual_tests(name, residuals, dof=dof, correlated_s=period_s, several=several)
            tests += found
            evidence |= numbers
        range_m = float(np.linalg.norm(memory.place_m(estimate)))
        tests += memory.frames.tests(range_m, self._tuning.range_share, self._tuning.correlated_s)
        if clocks is not None:
            tests += clocks.tests
            evidence |= clocks.evidence
        for one, other in combinations(sorted(memory.without), 2):
            there = [
                predict(memory.without[name], estimate.stamp_ns, self._filter)
                for name in (one, other)
                if memory.without[name].stamp_ns <= estimate.stamp_ns
            ]
            if len(there) == 2:
                name = f"the solutions without {one} and without {other}"
                tests.append(separation_test(name, there[0], there[1], self._config))
        for offset in mount_offsets(estimate, self._limits, self._filter.mount_sigma_m):
            tests.append(mount_test(offset, estimate, self._config))
            evidence |= offset.evidence
        return tests + declared_tests(estimate), evidence

    def _clocks(self, memory: Memory, estimate: FilterState) -> TwoClocks | None:
        """Return what two sensors tell of their clocks, or have told before one fell silent."""
        there = memory.without_at(estimate.stamp_ns, self._filter)
        if not len(there) == len(memory.without) == 2:
            return memory.clocks_at(estimate.stamp_ns, self._tuning.memory_s)
        by_states = bool(self._filter.mount_sigma_deg or self._filter.mount_sigma_m)
        return two_clocks(
            Pair(*sorted(there)),
            [there[name] for name in sorted(there)],
            () if by_states else memory.apart.get(memory.slow, ()),
            slow=memory.slow,
            estimate=estimate,
            config=self._config,
        )

    def _limit(self, memory: Memory, state: NavigatorState, estimate: FilterState) -> tuple[float, float]:
        """Return the alert limits of attitude, deg, and position, m.

        If several sensors support the track, the largest of their limits counts: a further sensor does not
        make an estimate less usable.
        """
        stamp_ns = estimate.stamp_ns
        names = {memory.sensor} | {
            name for name, stream in state.streams.items() if stream.supports(stamp_ns, self._tuning.group_s)
        }
        limits = [self._limits[name] for name in names if name in self._limits] or [AlertLimit()]
        range_m = float(np.linalg.norm(estimate.T_chaser_target.translation))
        return max(each.attitude_deg for each in limits), max(
            each.position_limit_m(range_m) for each in limits
        )

    def _levels(
        self,
        memory: Memory,
        state: NavigatorState,
        output: Output,
        estimate: FilterState,
        *,
        limit: tuple[float, float],
        clocks: TwoClocks | None,
    ) -> tuple[Levels, str]:
        """Return the protection levels, and the errors that they do not cover, in words.

        The levels are those over all fault hypotheses, with three exceptions, so that a further sensor or
        test does not make an estimate unavailable. The hypotheses that one of several sensors, or its clock,
        is wrong are left out if the levels with them are above the limits. A part of a sensor's data is left
        out if its own error is above the limits. Sizes that no frame can exclude are left out if the levels
        with them are above the limits. The text names the exception.
        """
        share = self._tuning.fault_share
        solutions, less = [solution("", estimate, estimate, 1.0)], ""
        assert state.history is not None  # noqa: S101 - guaranteed by the caller
        solutions += older_solutions(state.history, estimate, self._filter, self._tuning)
        solutions += refused_solutions(state.history, share)
        solutions += turning_solutions(estimate, self._filter, share)
        solutions += rival_solutions(output.status.hypotheses, estimate, self._config.risk)
        shifts = shifts_of(estimate, memory.sized, self._filter)
        other_sizes, between = memory.frames.size_solutions(
            estimate, self._config.risk, share, self._tuning.correlated_s, shifts
        )
        solutions += other_sizes
        place_m, without = memory.place_m(estimate), memory.without_at(estimate.stamp_ns, self._filter)
        followed = memory.frames.ranges_followed(estimate, without, place_m)
        twist = estimate.velocity_m_s, estimate.rate_rad_s
        unseen = declared_covariance(self._config, place_m, *twist, followed=followed)
        levels_of = LevelsOf(unseen, self._config.risk).by
        parts = memory.frames.solutions(estimate, place_m, share, self._tuning.range_share)
        for part in parts:
            if vague := above(levels_of([part.agreeing]), *limit):
                less = f"{SIZE_BELIEVED}: {vague}"
            else:
                solutions.append(part.solution)
        if between and (over := above(levels_of([*solutions, *between]), *limit)):
            less = f"{SIZE_DECLARED}: {over}"
        else:
            solutions += between
        if clocks is not None:
            with_clocks = [*solutions, *clocks.solutions(estimate, share)]
            if over := above(levels_of(with_clocks), *limit):
                less = less or f"{DECLARED_ONLY}: {over}"
            solutions = solutions if over else with_clocks
        of_sensors = [solution(f"without {name}", estimate, other, share) for name, other in without.items()]
        levels = levels_of([*solutions, *of_sensors])
        if of_sensors and (over := above(levels, *limit)):
            return levels_of(solutions), f"{DECLARED_ONLY}: {over}"
        return levels, less

    # --- the result ---

    def _checked(
        self,
        memory: Memory,
        output: Output,
        estimate: FilterState,
        limit: tuple[float, float],
        *,
        tests: list[Statistic],
        levels: Levels,
        less: str,
        evidence: dict[str, float],
    ) -> Integrity:
        state, reason = IntegrityState.NOMINAL, ""
        if alert := self._alert(memory, estimate, tests):
            state, reason = IntegrityState.ALERT, alert
        elif over := above(levels, *limit):
            state, reason = IntegrityState.UNAVAILABLE, over
        elif caution := self._caution(output, tests):
            state, reason = IntegrityState.CAUTION, caution
        elif less:
            state, reason = IntegrityState.CAUTION, less
        return self._integrity(
            output,
            estimate.stamp_ns,
            state,
            reason,
            attitude_level_deg=levels.attitude_deg,
            position_level_m=levels.position_m,
            attitude_limit_deg=limit[0],
            position_limit_m=limit[1],
            evidence=evidence,
        )

    def _alert(self, memory: Memory, estimate: FilterState, tests: list[Statistic]) -> str:
        """Return why the estimate must not be used; empty if nothing contradicts it."""
        if wrong := memory.wrong.alert(estimate.stamp_ns):
            return wrong
        failed = [test.describe(self._config.risk) for test in tests if test.exceeds_risk(self._config.risk)]
        if failed:
            return failed[0]
        return memory.past.alert(estimate.stamp_ns, self._tuning.memory_s)

    def _caution(self, output: Output, tests: list[Statistic]) -> str:
        """Return why the estimate needs care; empty if it does not.

        A sensor that is configured for other distances says nothing about the estimate.
        """
        status = output.status
        if not status.accepted and output.cause is not Cause.OUT_OF_RANGE:
            return f"the newest measurement is not used: {status.reason}"
        if status.belief is not BeliefLevel.ACCEPTED:
            return "the newest measurement supports the pose weakly"
        risk = self._tuning.caution_risk
        return next((test.describe(risk) for test in tests if test.exceeds_risk(risk)), "")

    def _integrity(
        self,
        output: Output,
        stamp_ns: int,
        state: IntegrityState,
        reason: str,
        **levels: float | dict[str, float],
    ) -> Integrity:
        return Integrity.model_validate(
            {
                "stamp_ns": stamp_ns,
                "frame_id": output.status.frame_id,
                "state": state,
                "reason": reason,
                "risk": self._config.risk,
                **levels,
            }
        )


def _without_newcomers(
    state: NavigatorState, sensor: str, stamp_ns: int, config: FilterConfig
) -> FilterState | None:
    """Return the filter without a sensor that is no part of the track; None for an established one.

    Before it joined, its frames were in the other filter already.
    """
    if sensor in state.established or not state.established:
        return None
    track = state.history if state.separation is None else state.separation.without
    return None if track is None else track.at(stamp_ns, config)
