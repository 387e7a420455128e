"""A loop is compiled once for arguments that are one to it."""

import gc
from types import FunctionType

import numpy as np
import pytest
from numba.core.errors import TypingError

from hammerstein.compiled import compiled, helper


@compiled(reads="values")
def add_up(values, first, total):
    for value in values[first:]:
        total[0] += value


@compiled()
def from_the_first_and_the_second(values, total):
    add_up(values, 0, total)
    add_up(values, 1, total)


@compiled(reads="values")
def wipe(values):
    values[0] = 0.0


@pytest.mark.parametrize("caller", [False, True])
def test_frozen_arrays_and_known_numbers_need_no_loop_of_their_own(caller):
    values, total = np.arange(4.0), np.zeros(1)
    frozen = values.copy()
    frozen.flags.writeable = False
    for given in (values, frozen, values):
        if caller:
            from_the_first_and_the_second(given, total)
        else:
            add_up(given, 0, total)
            add_up(given, 1, total)
    assert total[0] == 3 * 2 * values.sum()
    assert len(add_up.overloads) == 1


def test_a_loop_that_two_others_call_is_found_at_once():
    """Types that are told to numba twice are ambiguous: it would ask for the loop at every call."""

    @compiled(reads="values")
    def first_of(values):
        return values[0]

    @compiled()
    def doubled(values):
        return 2.0 * first_of(values)

    @compiled()
    def trebled(values):
        return 3.0 * first_of(values)

    values, asked = np.ones(3), []
    assert (first_of(values), doubled(values), trebled(values)) == (1.0, 2.0, 3.0)
    ask = first_of.compile
    first_of.compile = lambda given: asked.append(given) or ask(given)
    assert first_of(values) == 1.0
    assert asked == []


def test_a_loop_cannot_write_to_what_it_only_reads():
    with pytest.raises(TypingError, match="readonly"):
        wipe(np.ones(1))


def test_a_helper_is_compiled_as_a_part_of_its_loop():
    @helper(error_model="numpy")
    def over(value):
        return 1.0 / value

    @compiled()
    def all_over(values):
        for i in range(len(values)):
            values[i] = over(values[i])

    values = np.array([2.0, 0.0])
    all_over(values)
    np.testing.assert_array_equal(values, [0.5, np.inf])
    assert over(2.0) == 0.5
    assert isinstance(over, FunctionType)  # there is nothing of its own to compile or to keep


def test_no_garbage_is_searched_while_a_loop_is_compiled():
    @compiled()
    def halve(value):
        return 0.5 * value

    once, searched = halve.compile, []
    compile_it = once.compile

    def watched(given):
        searched.append(gc.isenabled())
        return compile_it(given)

    once.compile = watched
    assert halve(1.0) == 0.5
    assert searched == [False]
    assert gc.isenabled()
