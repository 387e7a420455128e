"""The exact inverse of plays and dead-zones side by side."""

import itertools

import numpy as np
import pytest
import theory

from hammerstein.blocks.voltages import Voltages
from hammerstein.compensators.exact.inverse import ExactInverseLaw
from hammerstein.compensators.reach import reach
from hammerstein.dynamics import StaticDynamics
from hammerstein.errors import SimulationError
from hammerstein.hysteresis import Asymmetric, DeadZones, Pair, PrandtlIshlinskii
from hammerstein.hysteresis.invertibility import invertibility
from hammerstein.model import HammersteinModel

SEED = 16


def model_of(pairs, zones, working_point_v=None, amplitude_v=8.0):
    p, m = len(pairs), len(pairs[0])
    rest = np.zeros(m) if working_point_v is None else np.asarray(working_point_v, dtype=float)
    names = [tuple(f"{letter}{i}" for i in range(n)) for letter, n in (("u", m), ("y", p))]
    hysteresis = Asymmetric(PrandtlIshlinskii(pairs), zones, rest)
    voltages = Voltages.of(rest.tolist(), rest - amplitude_v, rest + amplitude_v)
    dynamics = StaticDynamics(n_outputs=p)
    return HammersteinModel("test", hysteresis, dynamics, amplitude_v, *names, voltages=voltages)


def random_pair(generator, smallest, low, high):
    """Plays and dead-zones of either sign whose joint slopes stay between two bounds."""
    n, k = int(generator.integers(1, 8)), int(generator.integers(0, 6))
    r = np.unique(np.concatenate([[smallest], smallest + generator.uniform(0.0, 8.0, n - 1)]))
    w = np.diff(generator.uniform(low, 0.6 * high, len(r)), prepend=0.0)
    q = np.unique(generator.uniform(-9.0, 9.0, k))
    swing = generator.uniform(-0.4 * abs(low), 0.4 * high, len(q))
    return Pair(r, w), DeadZones(q, np.diff(swing, prepend=0.0))


def random_model(generator, m, p):
    smallest = np.where(generator.random(m) < 0.5, 0.0, generator.uniform(0.0, 0.3, m))
    cross = 5.0 / m
    rows, zones = [], []
    for o in range(p):
        kinds = [(1.0, 8.0) if o == k % p else (-cross, cross) for k in range(m)]
        row, bends = zip(*(random_pair(generator, smallest[k], *kinds[k]) for k in range(m)), strict=True)
        gone = [o != k % p and generator.random() < 0.2 for k in range(m)]
        rows.append([Pair.absent() if out else pair for pair, out in zip(row, gone, strict=True)])
        zones.append(list(bends))
    return model_of(rows, zones, generator.uniform(-2.0, 2.0, m))


def path_with_minor_loops(generator, p):
    """A random walk, a plateau, jumps, and decaying oscillations; 260 samples."""
    walk = np.cumsum(generator.normal(0.0, 3.0, (p, 80)), axis=1)
    plateau = np.repeat(walk[:, -1:], 20, axis=1)
    jumps = generator.uniform(-40.0, 40.0, (p, 40))
    cycles = np.arange(120) * 0.4
    phases = generator.uniform(0.0, 6.0, (p, 1))
    return np.hstack([walk, plateau, jumps, 30.0 * np.sin(cycles + phases) * np.linspace(1.0, 0.0, 120)])


def by_theory(model, sent):
    block, rest = model.hysteresis, np.array(model.recorded.working_point_v)
    of = [[[pair.thresholds_v for pair in row] for row in block.plays.pairs],
          [[pair.weights_um_per_v for pair in row] for row in block.plays.pairs],
          [[zone.breakpoints_v for zone in row] for row in block.zones],
          [[zone.weights_um_per_v for zone in row] for row in block.zones]]  # fmt: skip
    return theory.asymmetric(sent, *of, rest)


def signs(model):
    """Signs of the determinants over every combination of slopes, from the definition alone."""
    block = model.hysteresis
    columns = []
    for k in range(block.n_inputs):
        thresholds = np.unique(np.concatenate([row[k].thresholds_v for row in block.plays.pairs]))
        breakpoints = np.unique(np.concatenate([row[k].breakpoints_v for row in block.zones]))
        column = [
            [
                sum(w for r, w in zip(pair.thresholds_v, pair.weights_um_per_v, strict=True) if r <= top)
                + sum(b for q, b in zip(zone.breakpoints_v, zone.weights_um_per_v, strict=True) if q <= level)
                for pair, zone in (
                    (prow[k], zrow[k]) for prow, zrow in zip(block.plays.pairs, block.zones, strict=True)
                )
            ]
            for top in thresholds
            for level in (-np.inf, *breakpoints)
        ]
        columns.append(column)
    return {int(np.sign(np.linalg.det(np.array(choice).T))) for choice in itertools.product(*columns)}


@pytest.mark.full
def test_solves_100_random_models_on_paths_with_many_minor_loops():
    generator, found, worst = np.random.default_rng(SEED), 0, 0.0
    while found < 100:
        model = random_model(generator, 2, 2)
        if len(signs(model)) != 1:
            assert not invertibility(model.hysteresis).invertible
            continue
        assert invertibility(model.hysteresis).invertible
        found += 1
        path = path_with_minor_loops(generator, 2)
        law = ExactInverseLaw(model, 1e4)
        drive, _ = law.respond(path)
        worst = max(worst, np.abs(by_theory(model, drive) - path).max())
    assert worst <= 1e-9


@pytest.mark.full
@pytest.mark.parametrize(("m", "p"), [(1, 1), (3, 3), (3, 2)])
def test_other_shapes_are_solved_too(m, p):
    generator, found = np.random.default_rng([SEED, m, p]), 0
    while found < 5:
        model = random_model(generator, m, p)
        try:
            law = ExactInverseLaw(model, 1e4)
        except SimulationError:
            continue
        found += 1
        path = path_with_minor_loops(generator, p)
        np.testing.assert_allclose(by_theory(model, law.respond(path)[0]), path, atol=1e-9)


def test_step_equals_respond_and_states_are_carried():
    generator = np.random.default_rng(SEED)
    while True:
        model = random_model(generator, 2, 2)
        if len(signs(model)) == 1:
            break
    law = ExactInverseLaw(model, 1e4)
    path = path_with_minor_loops(generator, 2)
    whole, _ = law.respond(path)
    state, steps = law.rest(), []
    for k in range(path.shape[1]):
        drive, state = law.step(path[:, k], state)
        state = law.restore(state.as_dict())
        steps.append(drive)
    np.testing.assert_array_equal(np.stack(steps, axis=1), whole)


def test_breakpoints_met_exactly_and_paths_that_turn_there():
    model = model_of([[Pair([0.0, 1.0], [2.0, 1.0])]], [[DeadZones([-2.0, 1.0, 3.0], [0.5, -1.0, 0.8])]])
    sent = np.array([[0.0, 1.0, 3.0, 4.0, 3.0, 1.0, 1.0, 3.0, -2.0, -3.0, -2.0, 1.0, -2.0, 5.0, 0.0]])
    path = by_theory(model, sent)
    np.testing.assert_allclose(ExactInverseLaw(model, 20.0).respond(path)[0], sent, atol=1e-12)


def test_the_trap_of_a_smallest_threshold_above_zero_is_none_behind_it():
    """A falling dead-zone: beside play(u; r) the output would rise while the voltage falls."""
    model = model_of([[Pair([0.5, 2.0], [2.0, 1.0])]], [[DeadZones([1.0], [-1.2])]])
    path = path_with_minor_loops(np.random.default_rng(SEED), 1)
    drive, _ = ExactInverseLaw(model, 1e3).respond(path)
    np.testing.assert_allclose(by_theory(model, drive), path, atol=1e-9)


def test_a_model_that_a_zone_spoils_is_refused_with_its_voltages():
    model = model_of([[Pair([0.0, 1.0], [2.0, 1.0])]], [[DeadZones([1.0, 3.0], [-2.5, 2.5])]], [10.0])
    with pytest.raises(SimulationError, match=r"1 moving operator .* between 1 and 3 V"):
        ExactInverseLaw(model, (1.0, 19.0))


def test_zones_that_the_range_never_reaches_do_not_count():
    model = model_of([[Pair([0.0, 1.0], [2.0, 1.0])]], [[DeadZones([6.0], [-5.0])]])
    ExactInverseLaw(model, (-8.0, 5.0))
    with pytest.raises(SimulationError, match="no inverse"):
        ExactInverseLaw(model, 8.0)


def test_reachable_slopes_are_those_that_a_long_random_drive_shows():
    """Slopes of small steps in a long random walk within the range: all listed, and most are seen."""
    block = Asymmetric(
        PrandtlIshlinskii([[Pair([0.0, 3.0, 4.5], [1.0, 2.0, 4.0])]]),
        [[DeadZones([-1.0, 1.0, 6.0], [0.1, 0.01, 50.0])]],
    )
    told = invertibility(block, 5.0)
    generator = np.random.default_rng(SEED)
    corners = np.concatenate([[0.0], generator.uniform(-5.0, 5.0, 3000)])
    u = np.interp(np.arange(0.0, 3000.0, 1e-2), np.arange(3001.0), corners)
    v = block.respond([u])[0][0]
    slopes = np.diff(v) / np.where(np.diff(u) == 0.0, np.nan, np.diff(u))
    allowed = {round(s + z, 9) for s in (1.0, 3.0, 7.0) for z in (0.0, 0.1, 0.11)}
    seen = {value for value in np.unique(slopes.round(9)) if value in allowed}
    assert told.positive == len(seen)


def test_reach_counts_the_dead_zones():
    model = model_of([[Pair([0.0, 1.0], [4.0, 2.0])]], [[DeadZones([5.0], [1.0])]])
    found = reach(model, (0.0, 20.0)).alone_um
    # plays: 2 to 118 um; the dead-zone adds 15 um at the top alone
    np.testing.assert_allclose(found, [[2.0, 133.0]], atol=1e-6)


def test_an_input_at_its_range_stands_there_and_comes_back():
    model = model_of([[Pair([0.0, 1.0], [2.0, 1.0])]], [[DeadZones([1.0], [0.5])]])
    law = ExactInverseLaw(model, 5.0)
    path = 30.0 * np.sin(np.linspace(0.0, 20.0, 500))[None, :]
    drive = law.respond(path)[0]
    assert np.abs(drive).max() == 5.0
    inside = np.abs(drive[0]) < 5.0
    np.testing.assert_allclose(by_theory(model, drive)[0, inside], path[0, inside], atol=1e-9)
