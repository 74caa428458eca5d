"""Further states of the filter: constants and Gauss-Markov processes, estimated and considered."""

from dataclasses import replace
from math import exp, inf, radians

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_pose.navigation.filter import POSE, Block, FilterState, predict, start, update
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator.filter import FilterConfig, FilterTuning
from rpod_schemas.poses import make_pose
from rpod_target import Equivalence, Symmetry

SECOND_NS = 1_000_000_000
PLAIN = FilterConfig(
    position_floor_m=0.0,
    attitude_floor_deg=0.0,
    acceleration_density_m2_s3=1e-12,
    angular_acceleration_density_rad2_s3=1e-12,
    initial_velocity_sigma_m_s=0.01,
    initial_rate_sigma_deg_s=0.5,
    tuning=FilterTuning(gate_nis=1e9, correlation_inflation=1.0),
)
"""Takes measurements at their word, and believes in slow steady motions."""
NOISE = np.diag([2e-3, 3e-3, 4e-3, 2e-3, 3e-3, 2e-3]) ** 2
AT = make_pose(rotation=Rotation.from_rotvec([0.3, -0.2, 0.5]), translation_m=[0.2, -0.1, 5.0])
BLOCKS = (
    Block("mount", np.zeros(6), np.repeat([0.01, 0.01], 3)),
    Block("shared", np.zeros(2), np.array([0.02, 0.01]), time_constant_s=2.0, considered=True),
)
BY_SHARED = np.zeros((6, 2))
BY_SHARED[0, 0] = BY_SHARED[4, 1] = 1.0
FIRST = {"shared": BY_SHARED}
SECOND = {"mount": np.eye(6)}


def shifted(pose: RigidTransform, error: FloatArray) -> RigidTransform:
    return make_pose(
        rotation=Rotation.from_rotvec(error[3:]) * pose.rotation, translation_m=pose.translation + error[:3]
    )


def run(seed: int, *, frames: int = 10) -> tuple[FilterState, FloatArray]:
    """Return the state after a run of two sensors on a moving target, and the errors of all its states."""
    rng = np.random.default_rng(seed)
    velocity, rate = rng.normal(size=3) * 0.01, rng.normal(size=3) * radians(0.5)
    mount, shared = rng.normal(size=6) * 0.01, rng.normal(size=2) * BLOCKS[1].sigma

    def truth(stamp_s: float) -> RigidTransform:
        return shifted(AT, np.concatenate([velocity, rate]) * stamp_s)

    def measured(stamp_s: float, lasting: FloatArray) -> RigidTransform:
        return shifted(truth(stamp_s), lasting + rng.multivariate_normal(np.zeros(6), NOISE))

    first = measured(0.0, BY_SHARED @ shared)
    state = start(first, NOISE, 0, config=PLAIN, blocks=BLOCKS, sensitivities=FIRST)
    for stamp_s in 0.5 * np.arange(1, frames):
        kept = exp(-0.5 / 2.0)
        shared = kept * shared + np.sqrt(1.0 - kept**2) * rng.normal(size=2) * BLOCKS[1].sigma
        state = predict(state, round(stamp_s * SECOND_NS), PLAIN)
        for sensitivities, lasting in ((FIRST, BY_SHARED @ shared), (SECOND, mount)):
            pose = measured(stamp_s, lasting)
            state = update(state, pose, NOISE, config=PLAIN, sensitivities=sensitivities).state
    there, values = truth(0.5 * (frames - 1)), {block.name: block.value for block in state.blocks}
    turn = (state.T_chaser_target.rotation * there.rotation.inv()).as_rotvec()
    return state, np.concatenate(
        [
            state.T_chaser_target.translation - there.translation,
            turn,
            state.velocity_m_s - velocity,
            state.rate_rad_s - rate,
            values["mount"] - mount,
            values["shared"] - shared,
        ]
    )


def test_the_errors_of_all_states_are_as_large_as_their_covariance_says() -> None:
    nees = []
    for seed in range(60):
        state, errors = run(seed)
        nees.append(errors @ np.linalg.solve(state.covariance, errors))
    # the mean of 60 values of chi-squared with 20 degrees of freedom has a standard deviation of 0.82
    assert 17.5 < np.mean(nees) < 22.5


def test_a_considered_block_keeps_its_value_and_an_estimated_one_is_found() -> None:
    state, errors = run(3, frames=40)
    mount, shared = state.blocks
    assert not shared.value.any()
    sigma = np.sqrt(np.diag(state.covariance)[state.places()["mount"]])
    assert (sigma < 0.8 * mount.sigma).all()
    assert (np.abs(errors[state.places()["mount"]]) < 4.0 * sigma).all()


def test_an_error_that_all_frames_share_does_not_average_out() -> None:
    lasting = Block("lasting", np.zeros(6), np.full(6, 0.01), considered=True)
    by = {"lasting": np.eye(6)}
    state = start(AT, NOISE, 0, config=PLAIN, blocks=[lasting], sensitivities=by)
    alone = start(AT, NOISE, 0, config=PLAIN)
    for frame in range(1, 400):
        stamp_ns = frame * SECOND_NS // 10
        state = update(predict(state, stamp_ns, PLAIN), AT, NOISE, config=PLAIN, sensitivities=by).state
        alone = update(predict(alone, stamp_ns, PLAIN), AT, NOISE, config=PLAIN).state
    grown = state.covariance[POSE, POSE] - alone.covariance[POSE, POSE]
    np.testing.assert_allclose(grown, 1e-4 * np.eye(6), atol=2e-7)
    np.testing.assert_allclose(state.covariance[6:12, 6:12], alone.covariance[6:12, 6:12], atol=1e-12)


@pytest.mark.parametrize(
    ("constants", "kept"),
    [
        ((inf, inf), 1.0),
        ((4.0, inf), exp(-0.5)),
        ((inf, radians(40.0)), exp(-0.25)),
        ((4.0, radians(40.0)), exp(-0.75)),
        ((0.0, inf), 0.0),
    ],
)
def test_a_block_forgets_with_time_and_with_the_turn_of_the_view(
    constants: tuple[float, float], kept: float
) -> None:
    time_constant_s, turn_rad = constants
    sigma = np.array([0.1, 0.2])
    block = Block("bias", np.array([1.0, -1.0]), sigma, time_constant_s, turn_rad)
    state = start(AT, NOISE, 0, config=PLAIN, blocks=[block])
    P = state.covariance.copy()
    P[12:, 12:] *= 0.25  # known better than before
    P[0, 12] = P[12, 0] = 1e-4
    state = replace(state, rate_rad_s=np.array([0.0, 0.0, radians(5.0)]), covariance=P)
    later = predict(state, 2 * SECOND_NS, PLAIN)
    np.testing.assert_allclose(later.blocks[0].value, kept * block.value)
    left = kept**2 * 0.25 + 1.0 - kept**2
    np.testing.assert_allclose(np.diag(later.covariance)[12:], left * sigma**2)
    assert later.covariance[0, 12] == pytest.approx(kept * 1e-4)


def test_the_view_of_a_body_that_flies_past_turns_though_it_does_not() -> None:
    block = Block("model", np.ones(1), np.ones(1), turn_rad=1.0)
    state = replace(start(AT, NOISE, 0, config=PLAIN, blocks=[block]), velocity_m_s=np.array([0.5, 0.0, 0.0]))
    turned_rad = 0.5 * 5.0 / (AT.translation @ AT.translation)
    assert predict(state, SECOND_NS, PLAIN).blocks[0].value[0] == pytest.approx(exp(-turned_rad), rel=1e-3)


def test_no_block_turns_a_body_of_revolution_about_its_axis() -> None:
    alike = Equivalence.of([Symmetry((0.0, 0.0, 1.0), 1, exact=True, continuous=True)])
    block = Block("mount", np.zeros(6), np.full(6, 0.01))
    by = {"mount": np.eye(6)}
    state = start(AT, NOISE, 0, config=PLAIN, alike=alike, blocks=[block], sensitivities=by)
    state = update(state, shifted(AT, np.full(6, 0.004)), NOISE, config=PLAIN, sensitivities=by).state
    axis = state.T_chaser_target.rotation.as_matrix()[:, 2]
    about = np.zeros(state.size)
    about[3:6] = axis
    np.testing.assert_allclose(state.covariance @ about, 0.0, atol=1e-15)
    turn = (state.T_chaser_target.rotation * AT.rotation.inv()).as_rotvec()
    assert abs(turn @ axis) < 1e-6
