"""What holds for every kind of hysteresis: units, the order of inputs and outputs, what a fit asks of it."""

from dataclasses import fields

import numpy as np
import pytest

from hammerstein.errors import InputError
from hammerstein.hysteresis import (
    Asymmetric,
    BoucWen,
    DeadZones,
    Envelope,
    Generalised,
    Pair,
    Parallel,
    PrandtlIshlinskii,
    Preisach,
    RateDependent,
    RatePlays,
    slopes_of,
)
from hammerstein.hysteresis.bouc_wen import BoucWenPair
from hammerstein.hysteresis.identifiable import Driven, mean_slopes

T, REST = 1e-3, np.array([0.7, -1.3])
LIKE = np.random.default_rng(41)
R = np.array([[0.0, 0.6, 1.7, 3.1], [0.0, 0.9, 2.2, 4.0]])
"""Thresholds of each input, the same for all outputs."""
W = LIKE.uniform(0.2, 1.0, (2, 2, 4)) * [[[1.0], [0.1]], [[-0.12], [1.0]]]
Q, V = [[-2.0, 1.5, 3.0], [-1.0, 0.5, 2.5]], 0.15 * LIKE.uniform(-1.0, 1.0, (2, 2, 3))
LOW, HIGH = np.array([-6.0, -7.0]), np.array([8.0, 5.0])
CELLS = np.tril(LIKE.uniform(0.05, 0.3, (2, 2, 5, 5)) + 0.4 * np.eye(5)) * W[:, :, :1, None]
BEND = LIKE.uniform(0.05, 0.3, (2, 2, 2))  # beta and beta + gamma


def plays_of(volt, order):
    return PrandtlIshlinskii([[Pair(volt * R[k], W[o, k] / volt) for k in order] for o in order])


def rate_dependent(volt, order):
    growth = np.array([0.0, 1e-3, 1e-3, 2e-3])
    plays = [RatePlays(volt * R[k], growth, (60.0, 90.0)[k], (0.0, 2e-2)[k] / volt) for k in order]
    return RateDependent(tuple(plays), [[W[o, k] / volt for k in order] for o in order]).on_grid(T)


def asymmetric(volt, order):
    zones = [[DeadZones(volt * np.array(Q[k]), V[o, k] / volt) for k in order] for o in order]
    return Asymmetric(plays_of(volt, order), zones)


def generalised(volt, order):
    given = [
        ([-6.0, -1.0, 2.0, 7.0], [-5.0, -1.5, 3.0, 6.0], 1.5, 0.3, -0.5),
        ([-5.0, 0.0, 6.0], [-7.0, -1.0, 4.0]),
    ]
    each = [
        Envelope(
            volt * np.array(u),
            volt * np.array(g),
            *bend[:1] and (volt * bend[0], bend[1] / volt, volt * bend[2]),
        )
        for u, g, *bend in given
    ]
    return Generalised(tuple(each[k] for k in order), plays_of(volt, order))


def bouc_wen(volt, order):
    def pair(o, k):
        beta, load = sorted(BEND[o, k] / volt)
        return BoucWenPair(W[o, k, 0] / volt, 0.4 * W[o, k, 1] / volt, beta, load - beta)

    return BoucWen([[pair(o, k) for k in order] for o in order])


def preisach(volt, order):
    return Preisach(
        volt * LOW[order], volt * HIGH[order], [[CELLS[o, k] / volt for k in order] for o in order]
    )


def parallel(volt, order):
    return Parallel((asymmetric(volt, order), bouc_wen(volt, order)))


IDENTIFIED = (plays_of, rate_dependent, asymmetric, generalised, bouc_wen, preisach)
KINDS = (*IDENTIFIED, parallel)
AS_GIVEN = [0, 1]


def made(build, volt=1.0, order=AS_GIVEN):
    """A block of two inputs and outputs that counts from a working point, in a unit of voltage."""
    return build(volt, order).counted_from(volt * REST[order])


def walk(seed, samples=150):
    return 6.0 * np.sin(np.cumsum(np.random.default_rng(seed).normal(0.0, 0.3, (2, samples)), axis=1))


def driven(volt=1.0, order=AS_GIVEN):
    """How records drive the inputs, beyond the working point on both sides."""
    low, high = volt * np.array([-5.0, -6.0])[order], volt * np.array([7.0, 4.5])[order]
    thresholds = tuple(volt * R[k] for k in order)
    rates, several = np.array([40.0, 90.0])[order], (True, True)
    names = tuple("ab"[k] for k in order)
    return Driven(low, high, volt * REST[order], 2, names, thresholds, T, 2.0, rates, several)


def told(block, volt=1.0, order=AS_GIVEN):
    """All that a block says of itself: arrays of outputs [um], and of slopes (output, input) [um/V]."""
    u, before = volt * walk(1)[order], volt * walk(2, 5)[order]
    low, high = volt * np.array([-4.0, -5.0])[order], volt * np.array([6.0, 3.0])[order]
    slopes = [slopes_of(block, k, 3.0 * volt) for k in range(2)]
    outputs = [block.respond(u)[0], block.respond(u, block.after(before))[0], block.standing(before)[0]]
    outputs += [*block.extremes(low, high)]
    gains = [block.gain(3.0 * volt), block.amplitude(volt * np.array([2.0, 5.0])[order]) / volt]
    gains += [np.stack([pick(own, axis=0) for own in slopes], axis=1) for pick in (np.min, np.max)]
    return outputs, [*gains, mean_slopes(block, driven(volt, order))]


@pytest.mark.parametrize("volt", [1e3, 1e-3])
@pytest.mark.parametrize("build", KINDS)
def test_a_block_does_not_depend_on_the_unit_of_its_voltages(build, volt):
    outputs, gains = told(made(build))
    in_unit, per_unit = told(made(build, volt=volt), volt=volt)
    for one, other in zip(outputs, in_unit, strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-9, atol=1e-9)
    for one, other in zip(gains, per_unit, strict=True):
        np.testing.assert_allclose(volt * other, one, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("build", KINDS)
def test_inputs_and_outputs_may_come_in_another_order(build):
    outputs, gains = told(made(build))
    turned, crossed = told(made(build, order=[1, 0]), order=[1, 0])
    for one, other in zip(outputs, turned, strict=True):
        np.testing.assert_allclose(other[::-1], one, atol=1e-9)
    for one, other in zip(gains, crossed, strict=True):
        np.testing.assert_allclose(other[::-1, ::-1], one, atol=1e-9)


@pytest.mark.parametrize("build", KINDS)
def test_what_the_inputs_do_one_by_one_adds_up(build):
    """A held input adds what it adds from rest; all are held at 0 where none moves."""
    block, u = made(build), walk(3)
    alone = [block.respond(np.where(np.arange(2)[:, None] == k, u, 0.0))[0] for k in range(2)]
    np.testing.assert_allclose(block.respond(u)[0], sum(alone), atol=1e-9)


@pytest.mark.parametrize("passes", [1, 3])
@pytest.mark.parametrize("build", IDENTIFIED)
def test_the_columns_of_the_weights_add_up_to_the_output(build, passes):
    """After a path that ends farthest away, from rest or repeated; long ways of Bouc-Wen go otherwise."""
    block, before, near = made(build), walk(5, 4), 1e-4 if build is bouc_wen else 1e-9
    u = np.hstack([0.6 * walk(4), [[5.0], [-5.0]]])
    stood, memory = block.respond(before[:, -1:], block.after(before))
    for _ in range(passes):
        expected, memory = block.respond(u, memory)
    for o, weights in enumerate(block.weights):
        values, held = block.columns(u, before, o, passes)
        np.testing.assert_allclose(weights @ values, expected[o], atol=near)
        assert weights @ held == pytest.approx(stood[o, 0], abs=near)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("build", IDENTIFIED)
def test_weights_within_their_bounds_have_no_slope_below_the_least(build, sign):
    """Nor is one above it where all are at their bounds: driven slowly, and behind an envelope."""
    block, rng, least = made(build).on_grid(1e9), np.random.default_rng(7), 0.2 * sign
    for o, k in np.ndindex(2, 2):
        bounds = block.weight_bounds(o, k, least, driven())
        u = np.zeros((2, 400))
        u[k] = np.interp(np.arange(400), 50 * np.arange(9), [0, 6, -5, 4, -2, 7, 0, 1, -6])
        seen = block.envelopes[k].of(u[k] + REST[k]) if build is generalised else u[k]
        for beyond in (0.0, *rng.exponential(0.5, (5, len(bounds.side)))):
            weights = bounds.basis @ np.where(bounds.side == 0.0, 0.0, bounds.bound + bounds.side * beyond)
            rows = [weights if i == o else own for i, own in enumerate(block.weights)]
            slopes = sign * np.diff(block.with_weights(rows).respond(u)[0][o]) / np.diff(seen)
            assert slopes.min() > 0.2 - 1e-9
            assert np.any(beyond) or slopes.max() < 0.2 + 1e-9


def begun(build, volt=1.0, order=AS_GIVEN, within=False):
    """Outputs of the blocks that a fit begins with, with equal weights; or where they are free to go."""
    known = driven(volt, order)
    for guess in type(made(build)).first_guesses(known):
        here, limits = guess.counted_from(known.working_point_v).on_grid(T), guess.limits(known)
        free = limits.lower + np.linspace(0.2, 0.8, len(limits.lower)) * (limits.upper - limits.lower)
        block = here.at(free if within else here.free)
        weights = [np.ones(len(own)) / volt for own in block.weights]
        yield block.with_weights(weights).respond(volt * walk(6)[order])[0]


@pytest.mark.parametrize("build", IDENTIFIED)
def test_a_fit_begins_and_goes_alike_in_any_unit_and_order(build):
    first = list(begun(build))
    for other in (begun(build, volt=1e3), begun(build, order=[1, 0])):
        np.testing.assert_allclose(list(other), first, rtol=1e-9, atol=1e-9)
    free = [list(begun(build, volt, within=True)) for volt in (1.0, 1e3)]
    np.testing.assert_allclose(free[1], free[0], rtol=1e-9, atol=1e-9)


NAN = float("nan")
FALLS, GAP = [1.0, 0.5], [NAN, 0.5]
REFUSED = {
    Pair: {
        "thresholds_v": (FALLS, GAP, [-1.0, 0.5]),
        "weights_um_per_v": (GAP,),
        "weight_errors_um_per_v": ([1.0],),
    },
    DeadZones: {
        "breakpoints_v": (FALLS, GAP),
        "weights_um_per_v": (GAP,),
        "weight_errors_um_per_v": ([1.0],),
    },
    Envelope: {
        "voltages_v": (FALLS, GAP),
        "values_v": ([1.0], FALLS, GAP),
        "saturating_v": (-1.0,),
        "steepness_per_v": (NAN,),
    },
    BoucWenPair: {"direct_um_per_v": (NAN,), "beta_per_v": (-1.0,), "gamma_per_v": (-2.0,)},
    RatePlays: {
        "thresholds_v": (FALLS, GAP),
        "growth_s": ([0.0], FALLS),
        "bandwidth_hz": (0.0,),
        "lambda_s_per_v": (-1.0,),
    },
    Preisach: {
        "low_v": ([3.0],),
        "working_point_v": ([0.0, 1.0],),
        "cells_um_per_v": ([[np.eye(2), np.eye(2)]], [[np.ones((2, 2))]]),
    },
}
RIGHT = {
    Pair: ([0.0, 1.0], [1.0, 1.0]),
    DeadZones: ([0.0, 1.0], [1.0, 1.0]),
    Envelope: ([0.0, 1.0], [0.0, 1.0], 1.0, 1.0),
    BoucWenPair: (1.0, 0.5, 1.0, 0.0),
    RatePlays: ([0.0, 1.0], [0.0, 1e-3]),
    Preisach: ([-1.0], [1.0], [[np.eye(2)]]),
}


@pytest.mark.parametrize(
    ("kind", "wrong"),
    [
        (kind, {name: value})
        for kind, each in REFUSED.items()
        for name, values in each.items()
        for value in values
    ],
)
def test_a_part_that_is_refused_names_its_field_and_what_is_wrong(kind, wrong):
    names = [field.name for field in fields(kind)]
    with pytest.raises(InputError) as caught:
        kind(**dict(zip(names, RIGHT[kind], strict=False)) | wrong)
    for mistake in caught.value.mistakes:
        assert mistake.where in names
        assert " " in mistake.what
    kind(*RIGHT[kind])
