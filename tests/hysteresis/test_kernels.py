"""The turning-point form against the textbook loop, on everything that could break it."""

import numpy as np
import pytest
import theory
from hypothesis import given, settings, strategies as st

from hammerstein.hysteresis import Pair, PrandtlIshlinskii
from hammerstein.hysteresis.pair import search_guide
from hammerstein.hysteresis.play_kernels import BLOCK, WINDOW, first_at_least, move

RNG_SEED = 11


def textbook(model, u, starts=None):
    """Outputs and last plays by theory, every operator in every sample, for all outputs of its input."""
    bank, y, ends = model.bank, np.zeros((model.n_outputs, u.shape[1])), []
    for k, n in enumerate(bank.n):
        p = theory.plays(u[k], bank.r[k, :n], starts[k] if starts else np.zeros(n))
        y += bank.w[k, :n].T @ p
        ends.append(p[:, -1])
    return y, ends


def assert_equal_to_textbook(model, u):
    """Outputs to 1e-12 of their range, plays to 1e-12 of the input's."""
    v, state = model.respond(u)
    expected, plays = textbook(model, u)
    span = max(float(np.ptp(expected)), float(np.abs(expected).max()), 1e-9)
    # Weights of both signs cancel in the sum: the rounding is that of the sum of their sizes.
    scale = max(span, float(np.abs(model.bank.w).sum(axis=(0, 1)).max() * np.abs(u).max()))
    np.testing.assert_allclose(v, expected, rtol=0, atol=1e-12 * scale)
    for a, b in zip(model.plays_of(state), plays, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-12 * (1 + np.abs(u).max()))


def one_input(n, smallest=0.0, largest=9.7, outputs=2, spacing="even"):
    rng = np.random.default_rng(RNG_SEED + n)
    if spacing == "even":
        r = np.linspace(smallest, largest, n)
    elif spacing == "logarithmic":
        r = np.geomspace(max(smallest, 1e-7), largest, n)
    else:
        r = np.sort(rng.uniform(smallest, largest, n))
        r[0] = smallest
    w = rng.uniform(-0.2, 1.0, (outputs, n)) * 10 / n
    return PrandtlIshlinskii([[Pair(r, w[o])] for o in range(outputs)])


def random_walk(rng, samples):
    return np.clip(np.cumsum(rng.normal(0, 0.5, samples)), -11, 11)


def noise(rng, samples):
    return rng.uniform(-11, 11, samples)


def plateaus(rng, samples):
    return np.repeat(rng.uniform(-10, 10, samples // 5 + 1), 5)[:samples]


def repeated_extremes(rng, samples):
    """Turns at few voltages again and again, so that new turns meet old ones exactly."""
    return rng.integers(-4, 5, samples) * 2.5


def shrinking(rng, samples):
    """A decaying oscillation: no turn wipes out another, the memory grows as deep as it can."""
    return 10 * 0.995 ** np.arange(samples) * (-1.0) ** np.arange(samples)


def growing(rng, samples):
    """The reverse: every turn wipes out all the memory."""
    return shrinking(rng, samples)[::-1]


def noisy_sine(rng, samples):
    return 10 * np.sin(np.arange(samples) / 30) + rng.normal(0, 0.02, samples)


def tiny(rng, samples):
    """Never leaves the smallest dead zone."""
    return rng.uniform(-1e-3, 1e-3, samples)


SIGNALS = [random_walk, noise, plateaus, repeated_extremes, shrinking, growing, noisy_sine, tiny]


@pytest.mark.parametrize("signal", SIGNALS)
@pytest.mark.parametrize("smallest", [0.0, 0.07])
@pytest.mark.parametrize("n", [1, 2, 15, 150])
def test_turning_points_equal_the_textbook_loop(n, smallest, signal):
    u = signal(np.random.default_rng(RNG_SEED), 3000)[None]
    assert_equal_to_textbook(one_input(n, smallest), u)


@pytest.mark.parametrize("signal", [noise, random_walk, noisy_sine, shrinking])
@pytest.mark.parametrize("n", [1500, 10000])
def test_many_operators_equal_the_textbook_loop(n, signal):
    u = signal(np.random.default_rng(RNG_SEED), 600)[None]
    assert_equal_to_textbook(one_input(n, 0.01), u)


@pytest.mark.parametrize("signal", [noise, random_walk, repeated_extremes])
@pytest.mark.parametrize("spacing", ["logarithmic", "random"])
def test_uneven_grids_equal_the_textbook_loop(spacing, signal):
    u = signal(np.random.default_rng(RNG_SEED), 3000)[None]
    assert_equal_to_textbook(one_input(200, 1e-6, spacing=spacing), u)


def test_ragged_thresholds_and_several_inputs_equal_the_textbook_loop():
    rng = np.random.default_rng(RNG_SEED)
    lengths = [[3, 0, 40], [1, 7, 5]]
    model = PrandtlIshlinskii(
        [[Pair(np.sort(rng.uniform(0, 8, n)), rng.normal(size=n)) for n in row] for row in lengths]
    )
    u = np.stack(
        [random_walk(rng, 3 * BLOCK + 17), noise(rng, 3 * BLOCK + 17), plateaus(rng, 3 * BLOCK + 17)]
    )
    assert_equal_to_textbook(model, u)


@settings(max_examples=150)
@given(st.data())
def test_any_small_case_equals_the_textbook_loop(data):
    """Thresholds and voltages on one coarse grid meet each other exactly, all the time."""
    grid = st.integers(-12, 12).map(lambda i: i / 4)
    r = sorted({abs(value) for value in data.draw(st.lists(grid, min_size=1, max_size=8))})
    w = data.draw(st.lists(st.floats(-2, 2), min_size=len(r), max_size=len(r)))
    u = data.draw(st.lists(st.one_of(grid, st.floats(-4, 4)), min_size=1, max_size=40))
    assert_equal_to_textbook(PrandtlIshlinskii([[Pair(r, w)]]), np.array([u]))


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(1, 60), st.integers(1, 60))
def test_states_convert_both_ways(seed, before, after):
    """Turning points to plays, on with the textbook loop; its plays to turning points, and on."""
    rng = np.random.default_rng(seed)
    model = one_input(12, float(rng.choice([0.0, 0.07])))
    first, second = noise(rng, before)[None], noise(rng, after)[None]
    _, state = model.respond(first)
    by_textbook, plays = textbook(model, second, model.plays_of(state))
    scale = 1e-12 * 12 * np.abs(model.bank.w).sum()
    np.testing.assert_allclose(model.respond(second, state)[0], by_textbook, rtol=0, atol=scale)
    on = model.respond(first, model.state_of(plays))[0]
    np.testing.assert_allclose(on, textbook(model, first, plays)[0], rtol=0, atol=scale)


@pytest.mark.parametrize("signal", SIGNALS)
def test_a_state_holds_its_output(signal):
    """What lies below the top segment, which laws with feedback go on from."""
    model = one_input(40, 0.07)
    for samples in (1, 7, 50, 333, 3 * WINDOW + 5):
        v, s = model.respond(signal(np.random.default_rng(RNG_SEED), samples)[None])
        for state in (s, model.state_of(model.plays_of(s))):
            top = state.count[0] - 1
            k, x, d = state.end[0, top], state.x[0, top], state.d[0, top]
            held = model.bank.slope[0, k] * x - d * model.bank.moment[0, k] + state.below[0, top]
            np.testing.assert_allclose(held, v[:, -1], rtol=0, atol=1e-12 * 200)


@pytest.mark.parametrize("signal", SIGNALS)
@pytest.mark.parametrize("n", [1, 2, 15, 150])
def test_one_movement_at_a_time_gives_the_same_outputs(n, signal):
    """The form for laws with feedback, against the form for whole signals."""
    rng = np.random.default_rng(RNG_SEED)
    model, other = one_input(n, 0.07), one_input(7, 0.0)
    model = PrandtlIshlinskii([[a, b] for (a,), (b,) in zip(model.pairs, other.pairs, strict=True)])
    begun, samples = 2 * WINDOW + 5, 2 * WINDOW + 255
    u, b = np.stack([signal(rng, samples), noise(rng, samples)]), model.bank
    v, s = model.respond(u[:, :begun])
    v = np.concatenate([v, np.zeros((2, samples - begun))], axis=1)
    for t in range(begun, samples):
        for k in range(2):
            move(k, u[k, t], b.r, b.slope, b.moment, s.count, s.end, s.x, s.d, s.below, v[:, t])
    scale = 1e-12 * 12 * np.abs(b.w).sum()
    np.testing.assert_allclose(v, model.respond(u)[0], rtol=0, atol=scale)
    for plays, expected in zip(model.plays_of(s), model.plays_of(model.respond(u)[1]), strict=True):
        np.testing.assert_allclose(plays, expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize("n", [15, 150])  # in the busy form most of the time, and never
def test_no_rounding_grows_in_a_long_run(n):
    """A million samples of noise end where the same last samples end after a slow full swing."""
    model = one_input(n, 0.07)
    rng = np.random.default_rng(RNG_SEED)
    swing, last = 30.0 * np.cos(np.arange(3 * WINDOW) / 150.0)[None], noise(rng, 50)[None]
    _, worn = model.respond(noise(rng, 1_000_000)[None])
    v, _ = model.respond(np.concatenate([swing, last], axis=1), worn)
    fresh, _ = model.respond(np.concatenate([swing, last], axis=1))
    np.testing.assert_array_equal(v[:, 2 * WINDOW :], fresh[:, 2 * WINDOW :])


@pytest.mark.parametrize(
    "grid",
    [
        [0.0],
        [0.0, 1e-300],
        [5.0],
        np.linspace(0, 9.7, 15),
        np.geomspace(1e-12, 10, 500),
        np.concatenate([1.0 + np.arange(200) * 2.0**-50, [50.0]]),
    ],
)
def test_the_search_finds_the_first_threshold_at_or_above_a_level(grid):
    grid = np.asarray(grid)
    guide, scale = search_guide(grid[None], np.array([len(grid)]))
    between = np.random.default_rng(RNG_SEED).uniform(0, grid[-1], 300)
    levels = np.concatenate([[0.0], grid, np.nextafter(grid, 0), np.nextafter(grid[:-1], np.inf), between])
    for level in levels:
        found = first_at_least(level, level * scale[0], grid, guide[0])
        assert found == np.searchsorted(grid, level)
