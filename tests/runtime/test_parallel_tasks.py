"""Parallel tasks: in order, flat in memory, with whatever executor."""

import threading
import time
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial

import pytest

import hammerstein
from hammerstein.runtime.parallel_tasks import AHEAD, completed, in_order

SCENARIO = {
    "question": "How large is the error of drawn actuators?",
    "actuator": "duo_bimorph",
    "seed": 3,
    "reference": {"kind": "circle", "radius_um": 10.0, "frequency_hz": 50.0},
    "compensators": [{"label": "exact", "law": "exact_inverse", "model": "duo_bimorph"}],
    "sweep": {"frequency_hz": [20.0, 50.0]},
    "uncertainty": {"draws": 60, "weights": 0.02, "resonance": 0.01},
}


def late(number, wait_s):
    time.sleep(wait_s)
    return number


@pytest.mark.parametrize("jobs", [1, 3])
def test_results_come_in_order_however_long_each_takes(jobs):
    tasks = [partial(late, k, 0.1 if k % 3 == 0 else 0.0) for k in range(9)]
    assert list(in_order(tasks, jobs)) == list(range(9))


def test_what_is_known_is_not_done_again():
    assert list(in_order([completed("a"), partial(str, "b"), completed("c")], 2)) == ["a", "b", "c"]


def test_no_more_is_begun_than_is_soon_wanted():
    begun = []

    def tasks():
        for k in range(1000):
            begun.append(k)
            yield partial(late, k, 0.0)

    results = in_order(tasks(), 2)
    for k in range(50):
        assert next(results) == k
        assert len(begun) <= k + 2 + 2 * AHEAD
    results.close()


def fails(number):
    raise ValueError(f"task {number}")


def test_the_first_error_in_order_is_the_one_that_is_told_and_what_was_finished_is_handed_on():
    tasks = [
        partial(late, 0, 0.0),
        lambda: (time.sleep(0.3), fails(1)),
        partial(fails, 2),
        partial(late, 3, 0.0),
    ]
    done = []
    with pytest.raises(ValueError, match="task 1"):
        list(in_order(tasks, 4, lambda number, _: done.append(number)))
    assert sorted(done) == [0, 3]


def test_an_error_ends_the_threads_without_waiting_for_what_runs():
    hold = threading.Event()
    start = time.monotonic()
    with pytest.raises(ValueError, match="task 0"):
        list(in_order([partial(fails, 0), partial(hold.wait, 30.0)], 2))
    hold.set()
    assert time.monotonic() - start < 10.0


class Counted(Executor):
    """Another executor than any of ours."""

    def __init__(self):
        self.inner, self.count = ThreadPoolExecutor(2), 0

    def submit(self, fn, /, *args, **kwargs) -> Future:
        self.count += 1
        return self.inner.submit(fn, *args, **kwargs)


def test_any_executor_takes_cases_and_draws_and_changes_no_number():
    alone = hammerstein.run(SCENARIO).to_json()
    executor = Counted()
    assert hammerstein.run(SCENARIO, jobs=executor).to_json() == alone
    assert executor.count == 2 + 3
    assert hammerstein.run(SCENARIO, jobs=2).to_json() == alone


@pytest.mark.long
def test_processes_of_the_standard_library_take_them_as_well():
    with ProcessPoolExecutor(2) as executor:
        found = hammerstein.run(SCENARIO, jobs=executor).to_json()
    assert found == hammerstein.run(SCENARIO).to_json()
