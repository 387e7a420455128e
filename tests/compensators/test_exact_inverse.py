import itertools

import numpy as np
import pytest
import theory

from hammerstein.compensators.exact.inverse import ExactInverseLaw
from hammerstein.dynamics import StaticDynamics
from hammerstein.errors import InputError, SimulationError
from hammerstein.hysteresis import Pair, PrandtlIshlinskii
from hammerstein.hysteresis.invertibility import invertibility
from hammerstein.model import HammersteinModel


def _model(pairs, amplitude_v=8.0):
    hysteresis = PrandtlIshlinskii(pairs)
    p, m = hysteresis.n_outputs, hysteresis.n_inputs
    names = [tuple(f"{letter}{i}" for i in range(n)) for letter, n in (("u", m), ("y", p))]
    return HammersteinModel("test", hysteresis, StaticDynamics(n_outputs=p), amplitude_v, *names)


def _textbook(model, drive):
    pairs = model.hysteresis.pairs
    thresholds = [[pair.thresholds_v for pair in row] for row in pairs]
    return theory.prandtl_ishlinskii(
        drive, thresholds, [[pair.weights_um_per_v for pair in row] for row in pairs]
    )


def _table():
    return _model([[Pair(theory.R_V, w) for w in row] for row in theory.W_UM_PER_V], 10.0)


def _random_pair(generator, smallest, low, high):
    """Ragged thresholds, and weights of either sign whose partial sums stay between two bounds."""
    n = int(generator.integers(1, 8))
    thresholds = np.unique(np.concatenate([[smallest], smallest + generator.uniform(0.0, 8.0, n - 1)]))
    return Pair(thresholds, np.diff(generator.uniform(low, high, len(thresholds)), prepend=0.0))


def _random_model(generator, m, p):
    smallest = np.where(generator.random(m) < 0.5, 0.0, generator.uniform(0.0, 0.3, m))
    cross = 6.0 / m
    rows = []
    for o in range(p):
        kinds = [(1.0, 8.0) if o == k % p else (-cross, cross) for k in range(m)]
        row = [_random_pair(generator, smallest[k], *kinds[k]) for k in range(m)]
        absent = [o != k % p and generator.random() < 0.2 for k in range(m)]
        rows.append([Pair.absent() if gone else pair for pair, gone in zip(row, absent, strict=True)])
    return _model(rows)


def _path_with_minor_loops(generator, p):
    """A random walk, a plateau, jumps, and decaying oscillations; 260 samples."""
    walk = np.cumsum(generator.normal(0.0, 3.0, (p, 80)), axis=1)
    plateau = np.repeat(walk[:, -1:], 20, axis=1)
    jumps = generator.uniform(-40.0, 40.0, (p, 40))
    cycles = np.arange(120) * 0.4
    phases = generator.uniform(0.0, 6.0, (p, 1))
    return np.hstack([walk, plateau, jumps, 30.0 * np.sin(cycles + phases) * np.linspace(1.0, 0.0, 120)])


def _signs_of_determinants(model):
    """Signs for every combination of engaged operators, from weights and thresholds alone."""
    pairs = model.hysteresis.pairs
    columns = []
    for k in range(len(pairs[0])):
        grid = sorted({r for row in pairs for r in row[k].thresholds_v})
        sums = [[sum(row[k].weights_um_per_v[row[k].thresholds_v <= r]) for row in pairs] for r in grid]
        columns.append(sums)
    return {np.sign(round(np.linalg.det(np.array(choice)), 9)) for choice in itertools.product(*columns)}


def test_solves_random_models_on_paths_with_many_minor_loops():
    generator = np.random.default_rng(4)
    solved = refused = 0
    while solved < 100:
        m = int(generator.integers(1, 4))
        model = _random_model(generator, m, m)
        if len(_signs_of_determinants(model)) > 1:
            refused += 1
            with pytest.raises(SimulationError, match="has no inverse"):
                ExactInverseLaw(model, 1e4)
            continue
        path = _path_with_minor_loops(generator, m)
        drive, _ = ExactInverseLaw(model, 1e4).respond(path)
        assert np.abs(_textbook(model, drive) - path).max() < 1e-9
        solved += 1
    assert refused > 5


# To compile the loops for four inputs takes as long as for all others together.
@pytest.mark.parametrize(("m", "p"), [(2, 1), (3, 2), (3, 1), pytest.param(4, 2, marks=pytest.mark.long)])
def test_more_inputs_than_outputs_are_solved_too(m, p):
    generator, solved = np.random.default_rng(5), 0
    for _ in range(8):
        model = _random_model(generator, m, p)
        if not invertibility(model.hysteresis, 1e4, 8.0).invertible:
            continue
        path = _path_with_minor_loops(generator, p)
        drive, _ = ExactInverseLaw(model, 1e4).respond(path)
        assert np.abs(_textbook(model, drive) - path).max() < 1e-9
        solved += 1
    assert solved > 0


def test_least_drive_of_a_linear_actuator_is_the_pseudo_inverse():
    gain = np.array([[3.0, 2.0, 0.5], [0.2, 0.0, 4.0]])
    model = _model([[Pair.linear(g) if g else Pair.absent() for g in row] for row in gain])
    path = np.random.default_rng(0).uniform(-5.0, 5.0, (2, 30))
    drive, _ = ExactInverseLaw(model, 10.0).respond(path)
    np.testing.assert_allclose(drive, np.linalg.pinv(gain) @ path, atol=1e-12)


def test_a_spare_input_takes_over_where_another_stands_at_its_range():
    model = _model([[Pair([0.05, 1.0], [3.0, 1.0]), Pair([0.1, 2.0], [2.0, 1.0])]])
    path = 30.0 * np.sin(np.arange(400)[None] * 0.05)
    drive, _ = ExactInverseLaw(model, 5.0).respond(path)
    at_range = np.abs(drive) == 5.0
    assert at_range[0].any()
    assert not at_range.all(axis=0).any()
    assert np.abs(_textbook(model, drive) - path).max() < 1e-9


@pytest.mark.parametrize(
    ("pairs", "message"),
    [
        ([[Pair.linear(1.0)], [Pair.linear(2.0)]], "1 inputs for 2 outputs"),
        ([[Pair.linear(1.0), Pair.absent()]], "input 2 moves no output"),
        ([[Pair([11.0], [1.0])]], "beyond the range of 10 V"),
    ],
)
def test_models_that_no_drive_can_follow_are_refused(pairs, message):
    with pytest.raises((InputError, SimulationError), match=message):
        ExactInverseLaw(_model(pairs), 10.0)


def test_a_model_without_inverse_is_named_where_it_fails():
    model = _model([[Pair([0.0, 0.5, 2.0], [2.0, -3.0, 5.0])]])
    with pytest.raises(
        SimulationError, match=r"of its 3 .* 1 .* 2 moving operators \(thresholds up to 0.5 V\): \[-1"
    ):
        ExactInverseLaw(model, 10.0)
    drive, _ = ExactInverseLaw(model, 10.0, run_anyway=True).respond(
        _path_with_minor_loops(np.random.default_rng(1), 1)
    )
    assert np.abs(drive).max() <= 10.0


def test_a_singular_model_is_refused():
    model = _model([[Pair.linear(1.0), Pair.linear(2.0)], [Pair.linear(2.0), Pair.linear(4.0)]])
    with pytest.raises(SimulationError, match="1 is zero"):
        ExactInverseLaw(model, 10.0)


def test_where_the_output_stands_still_the_drive_stays():
    """Slope 2, then 0 from 1 V on: 2 um at most, however far the reference goes."""
    law = ExactInverseLaw(_model([[Pair([0.0, 1.0], [2.0, -2.0])]]), 10.0, run_anyway=True)
    drive, _ = law.respond(np.array([[0.5, 1.5, 10.0, 12.0]]))
    assert drive[0] == pytest.approx([0.25, 0.75, 1.0, 1.0])


def test_operators_that_the_range_never_engages_do_not_count():
    hysteresis = _model([[Pair([0.0, 5.0], [2.0, -3.0])]]).hysteresis
    assert not invertibility(hysteresis, 6.0).invertible
    assert invertibility(hysteresis, 5.0).invertible


def test_without_a_range_loops_of_twice_the_largest_threshold_complete_the_model():
    """Slopes 1 and -0.1 beside 0.27: gains (1 - 0.55, 0.27) at 16 V make all determinants positive."""
    wide = PrandtlIshlinskii([[Pair([0.0, 8.0], [1.0, -1.1]), Pair([0.0, 3.0], [0.27, 1e-6])]])
    assert invertibility(wide).invertible
    assert invertibility(wide, amplitude_v=16.0).invertible
    assert not invertibility(wide, amplitude_v=6.0).invertible


def test_both_ways_to_examine_determinants_agree():
    generator = np.random.default_rng(8)
    for _ in range(40):
        model = _random_model(generator, 2, 2)
        found = invertibility(model.hysteresis)
        assert found.invertible == (len(_signs_of_determinants(model)) == 1)


def test_printed_table_has_an_inverse_and_is_solved():
    law = ExactInverseLaw(_table(), 10.0)
    assert "225 slope matrices have the same sign" in law.statement()
    assert "its drive jumps: 0.14 V on input u0, 0.14 V on input u1." in law.statement()
    angle = 2.0 * np.pi * np.arange(800) / 400
    path = 50.0 * np.stack([np.cos(angle), np.sin(angle)])
    drive, _ = law.respond(path)
    assert np.abs(_textbook(_table(), drive) - path).max() < 1e-9
    backlash = PrandtlIshlinskii([[Pair([3.0], [2.0])]])
    assert "its only slope matrix is not singular" in invertibility(backlash).statement()


def test_a_model_without_an_inverse_counts_its_slopes():
    """2, then 2 - 2 = 0, then 0 - 1: two of three have not the sign of the others."""
    flawed = PrandtlIshlinskii([[Pair([0.0, 1.0, 2.0], [2.0, -2.0, -1.0])]])
    counted = "of its 3 slope matrices, 1 is of the other sign and 1 is zero"
    assert counted in invertibility(flawed).statement()


def test_one_play_is_inverted_by_a_jump_of_twice_its_threshold():
    path = np.array([[0.0, 6.0, 9.0, 8.0, 8.0, 2.0, 4.0]])
    drive, _ = ExactInverseLaw(_model([[Pair([0.3], [2.0])]]), 10.0).respond(path)
    direction = np.array([0.0, 1.0, 1.0, -1.0, -1.0, -1.0, 1.0])
    np.testing.assert_allclose(drive[0], path[0] / 2.0 + 0.3 * direction, atol=1e-12)


def test_equals_the_analytic_inverse_of_one_bank():
    """Kuhnen's inverse of the check pair, thresholds and weights as computed by hand."""
    r = np.arange(7) * 0.45
    w = [0.72, 0.6, 0.48, 0.36, 0.24, 0.12, 0.012]
    inverse_r = [0.0, 0.324, 0.918, 1.728, 2.7, 3.78, 4.914]
    slopes = np.cumsum(w)
    inverse_w = [1.0 / w[0], *(-np.array(w[1:]) / (slopes[1:] * slopes[:-1]))]
    path = 4.0 * np.sin(2.0 * np.pi * np.arange(1000) / 500)
    drive, _ = ExactInverseLaw(_model([[Pair(r, w)]]), 100.0).respond(path)
    np.testing.assert_allclose(
        drive, theory.prandtl_ishlinskii([path], [[inverse_r]], [[inverse_w]]), atol=1e-9
    )


def test_range_holds_one_input_and_the_other_goes_on_exactly():
    angle = 2.0 * np.pi * np.arange(1200) / 400
    path = np.stack([70.0 * np.cos(angle), 40.0 * np.sin(angle)])
    drive, _ = ExactInverseLaw(_table(), 10.0).respond(path)
    error = _textbook(_table(), drive) - path
    at_range = np.abs(drive) == 10.0
    assert np.abs(drive).max() == 10.0
    assert at_range[0].mean() > 0.3
    assert not at_range[1].any()
    assert np.abs(error[1]).max() < 1e-9
    assert np.abs(error[0, ~at_range[0]]).max() < 1e-9  # exact again as soon as it leaves the range


def test_softening_spreads_the_jump_and_lags_no_more_than_stated():
    r0, soft, slope = 0.3, 0.2, 2.0
    path = np.concatenate(
        [np.linspace(0.0, 8.0, 400), np.linspace(8.0, 2.0, 400), np.linspace(2.0, 4.0, 200)]
    )
    model = _model([[Pair([r0], [slope])]])
    hard, _ = ExactInverseLaw(model, 10.0).respond(path)
    drive, _ = ExactInverseLaw(model, 10.0, softening_v=soft).respond(path)
    turn = slice(395, 405)
    assert np.abs(np.diff(hard[0, turn])).max() > 2.0 * r0 - 0.02
    assert np.abs(np.diff(drive[0, turn])).max() < 0.1
    error = np.abs(_textbook(model, drive)[0] - path)
    bound = slope * 2.0 * r0 * soft / (2.0 * r0 + soft)
    assert 0.9 * bound < error[400:800].max() <= bound
    assert error[500:800].max() < 1e-9


def test_small_reversals_in_the_softened_jump_leave_no_trace():
    generator = np.random.default_rng(2)
    angle = 2.0 * np.pi * np.arange(1600) / 400
    path = 40.0 * np.stack([np.cos(angle), np.sin(angle)]) + 0.02 * generator.normal(size=(2, 1600))
    path[:, 1200:] = 40.0 * np.stack([np.cos(angle[1200:]), np.sin(angle[1200:])])
    drive, _ = ExactInverseLaw(_table(), 10.0, softening_v=0.01).respond(path)
    error = _textbook(_table(), drive) - path
    far_from_turns = (np.abs(np.sin(2.0 * angle)) > 0.5) & (angle > 2.0 * np.pi * 3.25)
    assert np.abs(error[:, far_from_turns]).max() < 1e-9


def test_a_plateau_moves_nothing():
    path = np.repeat(_path_with_minor_loops(np.random.default_rng(3), 2), 3, axis=1)
    drive, _ = ExactInverseLaw(_table(), 1e4).respond(path)
    held = drive.reshape(2, -1, 3)
    assert np.abs(np.diff(held, axis=2)).max() < 1e-12  # rounding; a false reversal would jump by 0.14 V


def test_softening_below_zero_is_refused():
    with pytest.raises(InputError, match="softening_v"):
        ExactInverseLaw(_table(), 10.0, softening_v=-0.1)


@pytest.mark.parametrize("scale", [1e-9, 1e6])
def test_the_drive_does_not_depend_on_the_unit_of_length(scale):
    """Path and weights in another unit: the same voltages."""
    time_s = 50e-6 * np.arange(2000)
    path = 30.0 * np.stack([np.sin(400.0 * time_s), np.sin(270.0 * time_s)])
    drives = [ExactInverseLaw(_scaled(factor), 10.0).drive_for(factor * path) for factor in (1.0, scale)]
    np.testing.assert_allclose(drives[1], drives[0], atol=1e-6)


def _scaled(factor):
    block = PrandtlIshlinskii.from_arrays(theory.R_V, factor * np.array(theory.W_UM_PER_V))
    return HammersteinModel("scaled", block, StaticDynamics(n_outputs=2), 10.0, ("u", "v"), ("x", "y"))


@pytest.mark.parametrize("gains", [[[5.0, 2.0, -1.0]], [[5.0, 0.5, 2.0], [-0.3, 4.0, 1.0]]])
def test_of_all_drives_of_more_inputs_than_outputs_it_takes_the_smallest(gains):
    """Of a model without hysteresis that is the pseudo-inverse of its gains."""
    model = _model([[Pair([0.0], [gain]) for gain in row] for row in gains])
    path = _path_with_minor_loops(np.random.default_rng(3), len(gains)) / 20.0
    drive, _ = ExactInverseLaw(model, 1e3).respond(path)
    np.testing.assert_allclose(drive, np.linalg.pinv(np.array(gains)) @ path, atol=1e-9)
