"""The Gauss-Newton loop of all registrations: linearise, sum, solve, move, with narrower scales step by step.

A *problem* is a record with the measurement, the model and the scales of its steps. ``linearised`` returns
its normal equations at a pose. Each kind of problem registers a kernel for that, by
``@linearises(ItsRecord)``; the kernel calls factors that add their residuals to one set of sums
(``normal_equations``). The record's type determines the kernel when the loop is compiled, so that nothing is
looked up at run time and the compiled code can be stored on disk. That would not be possible if kernels were
passed as arguments.

The design follows K. Koide, small_gicp (https://github.com/koide3/small_gicp): one registration with
exchangeable factors.
"""

from collections.abc import Callable
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numba import types
from numba.extending import overload

from rpod_geometry.kernels import generic_kernel
from rpod_pose.registration.lie_group import PoseArrays, stepped
from rpod_pose.registration.normal_equations import UNKNOWNS, held_step
from rpod_schemas.arrays import FloatArray

E = TypeVar("E")
K = TypeVar("K", bound=Callable[..., Any])


class State(NamedTuple):
    """The unknowns that the loop estimates."""

    pose: PoseArrays
    bias_m: float
    """Length by which all ranges are too long; it stays 0 in a problem with six unknowns."""


class Linear(NamedTuple, Generic[E]):
    """A problem linearised at one state."""

    sums: FloatArray
    """Information and gradient, shape (35,), as in ``normal_equations``."""
    hold: FloatArray
    """Prior information that the step is zero, shape (7,); each entry is above 0."""
    determined: bool
    """Whether the residuals suffice for a step."""
    evidence: E
    """Statistics of the problem, in a record of its own type."""


class Fit(NamedTuple, Generic[E]):
    """Result of the loop."""

    state: State
    linear: Linear[E]
    """The problem linearised at the state before the last step."""
    step: FloatArray
    """The last step, (dtau, dtheta, bias), shape (7,), m and rad; 0 if none was made."""
    steps: int
    """Number of steps made."""


def linearised(problem: Any, state: State, step: int) -> Linear[Any]:
    """Return a problem's normal equations at a state. Only kernels can call it.

    Args:
        problem: a record whose type was registered by ``linearises``.
        state: pose and bias to linearise at.
        step: number of the step, from 0, that chooses the scales.
    """
    raise NotImplementedError(f"{type(problem).__name__}: called by kernels only")


def linearises(record: type) -> Callable[[K], K]:
    """Register a kernel ``(problem, state, step) -> Linear`` for the problems of a record type."""

    def register(compiled: K) -> K:
        def chosen(problem: Any, state: Any, step: Any) -> Any:  # noqa: ARG001 - numba asks by name
            if isinstance(problem, types.NamedTuple) and problem.instance_class is record:
                return lambda problem, state, step: compiled(problem, state, step)  # noqa: PLW0108
            return None

        overload(linearised, strict=False)(chosen)
        return compiled

    return register


@generic_kernel
def minimised(problem: Any, start: State, steps: int) -> Fit[Any]:
    """Return the state after Gauss-Newton steps on a problem, one for each of its scales.

    Kernels call it, and in each the loop is compiled for its kind of problem. The loop ends early if the
    residuals determine no step, or if they are not finite.

    Args:
        problem: a record whose type was registered by ``linearises``.
        start: state to begin with.
        steps: number of steps to make.

    Raises:
        ValueError: ``steps`` is below 1.
    """
    if steps < 1:
        raise ValueError(
            "steps is below 1, so that nothing would be linearised: give the problem one scale or more"
        )
    state, last, step = start, np.zeros(UNKNOWNS), 0
    while True:
        linear = linearised(problem, state, step)
        if not (linear.determined and np.isfinite(linear.sums).all()):
            break
        last = held_step(linear.sums, linear.hold)
        state = State(stepped(state.pose, last[:6]), state.bias_m + last[6])
        step += 1
        if step >= steps:
            break
    return Fit(state, linear, last, step)
