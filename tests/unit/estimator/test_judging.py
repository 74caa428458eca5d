"""Judgements in a thread of their own, in their order."""

from sys import getswitchinterval
from threading import Event, get_ident

import pytest

from rpod_estimator.judging import Judging

WAIT_S = 10.0


def test_judgements_keep_their_order_and_the_caller_goes_on():
    begun, may_end, done = Event(), Event(), []

    def slow() -> None:
        begun.set()
        assert may_end.wait(WAIT_S)
        done.append(("slow", get_ident()))

    with Judging(at_once=False) as judging:
        judging.add(slow)
        assert begun.wait(WAIT_S)
        assert done == []  # the caller goes on before the judgement is done
        may_end.set()
        judging.add(lambda: done.append(("next", get_ident())))
    assert [name for name, _ in done] == ["slow", "next"]
    assert get_ident() not in {thread for _, thread in done}


@pytest.mark.parametrize("at_once", [False, True])
def test_the_main_loop_gets_the_lock_back_soon_while_another_thread_judges(at_once):
    before_s = getswitchinterval()
    with Judging(at_once=at_once):
        assert (getswitchinterval() < 0.1 * before_s) is not at_once
    assert getswitchinterval() == pytest.approx(before_s)


def test_at_most_one_judgement_waits():
    done: list[int] = []
    with Judging(at_once=False) as judging:
        for number in range(5):
            judging.add(lambda number=number: done.append(number))
            assert len(done) >= number


def test_all_judgements_are_done_at_the_end():
    done: list[int] = []
    with Judging(at_once=False) as judging:
        judging.add(lambda: done.append(1))
    assert done == [1]


def test_an_error_of_a_judgement_is_raised_in_the_callers_thread():
    def failing() -> None:
        raise ValueError("no level")

    with Judging(at_once=False) as judging:
        judging.add(failing)
        with pytest.raises(ValueError, match="no level"):
            judging.add(lambda: None)


def test_judgements_at_once_run_in_the_callers_thread():
    threads = []
    with Judging(at_once=True) as judging:
        judging.add(lambda: threads.append(get_ident()))
        assert threads == [get_ident()]
