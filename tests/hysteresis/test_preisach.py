"""Planes of relays with several inputs and outputs: the Preisach model as a kind of hysteresis."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import theory
from hypothesis import given, settings, strategies as st

import hammerstein
from hammerstein.blocks.voltages import Voltages
from hammerstein.dynamics import AxesDynamics, Axis, StaticDynamics, discretise
from hammerstein.errors import InputError, SimulationError
from hammerstein.hysteresis import Hysteresis, Preisach
from hammerstein.hysteresis.invertibility import every_matrix, invertibility, outermost
from hammerstein.identification.identify import identify
from hammerstein.identification.settings import Settings
from hammerstein.model import HammersteinModel
from hammerstein.records.record import Record

SEED = 31
LOW, HIGH = [-5.0, -6.0], [6.0, 4.0]
R, W = [0.0, 10.0, 20.0, 40.0], [0.5, 0.12, 0.15, 0.1]


def random_model(seed, m=2, n=6):
    """Planes without cells of weight 0, whose cross-couplings have either sign."""
    generator = np.random.default_rng(seed)
    rows = []
    for o in range(m):
        triangles = []
        for k in range(m):
            cells = np.tril(generator.uniform(0.0, 0.3, (n, n))) + 0.3 * np.eye(n)
            triangles.append(cells if o == k else generator.choice([-0.05, 0.05]) * cells)
        rows.append(triangles)
    block = Preisach(LOW[:m], HIGH[:m], rows)
    rest = generator.uniform(-2.0, 2.0, m)
    names = tuple(f"u{k}" for k in range(m)), tuple(f"y{o}" for o in range(m))
    voltages = Voltages.of(rest.tolist(), rest - 9.0, rest + 9.0)
    return HammersteinModel("test", block, StaticDynamics(n_outputs=m), 9.0, *names, voltages=voltages)


def walk(seed, m, n=300):
    """Voltages as they are sent, beyond both ends of the planes."""
    return 7.0 * np.sin(np.cumsum(np.random.default_rng(seed).normal(0.0, 0.4, (m, n)), axis=1))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_every_output_hears_the_relays_of_every_input(seed):
    """At the levels, from where all relays are off; voltages as they are sent, counted from rest."""
    model, generator, n = random_model(seed), np.random.default_rng(seed), 6
    levels = [np.linspace(low, high, n + 1) for low, high in zip(LOW, HIGH, strict=True)]
    u = np.array([np.append(own[0], generator.choice(own, 100)) for own in levels])
    rest = np.array(model.recorded.working_point_v)[:, None]
    found = model.hysteresis.counted_from(rest[:, 0]).respond(u - rest)[0]
    for o, row in enumerate(model.hysteresis.cells_um_per_v):
        whole = sum(theory.relay_sum(u[k], LOW[k], HIGH[k], row[k]) for k in range(2))
        np.testing.assert_allclose(found[o] - found[o, 0], whole, atol=1e-11)


@pytest.mark.parametrize("cells", [10, 20, 40])
def test_plays_that_were_never_driven_are_there_from_the_first_sample(cells):
    """Thresholds and turns at levels of a plane about the working point."""
    size = 100.0 / cells
    weights = sum(w * np.eye(cells, k=-round(2.0 * r / size)) for r, w in zip(R, W, strict=True))
    block = Preisach([-30.0], [70.0], [[weights]], [20.0])
    generator = np.random.default_rng(cells)
    u = np.append(0.0, size * generator.integers(-cells // 2, cells // 2 + 1, 200))
    expected = theory.prandtl_ishlinskii([u], [[R]], [[W]])
    np.testing.assert_allclose(block.respond(u[None])[0], expected, atol=1e-12)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 299))
def test_parts_and_steps_give_the_same_bits(seed, cut):
    block, u = random_model(seed).hysteresis, walk(seed, 2)
    whole, end = block.respond(u)
    first, state = block.respond(u[:, :cut])
    second, _ = block.respond(u[:, cut:], block.restore(state.as_dict()))
    np.testing.assert_array_equal(np.hstack([first, second]), whole)
    state, each = block.rest(), []
    for sample in u.T:
        y, state = block.step(sample, state)
        each.append(y)
    np.testing.assert_array_equal(np.stack(each, axis=1), whole)
    assert state.as_dict() == end.as_dict()


@pytest.mark.full
@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 3))
def test_the_inverse_puts_coupled_axes_on_any_path(seed, m):
    model = random_model(seed, min(m, 2))
    u = walk(seed, min(m, 2))
    rest = np.array(model.recorded.working_point_v)[:, None]
    goal = model.static_response(u)[0] - model.static_response(rest)[0]
    law = hammerstein.ExactInverse().design(model, 40.0, 1e-3)
    drive = law.respond(goal)[0]
    np.testing.assert_allclose(model.static_response(drive)[0], goal, atol=1e-12)
    np.testing.assert_allclose(drive, u, atol=1e-11)
    state, each = law.rest(), []
    for sample in goal.T:
        v, state = law.step(sample, state)
        each.append(v)
    np.testing.assert_array_equal(np.stack(each, axis=1), drive)


@pytest.mark.full
def test_at_the_end_of_the_range_the_drive_stands_there_and_comes_back():
    model, low, high = random_model(3, 1), -4.0, 5.0
    law = hammerstein.ExactInverse().design(model, (low, high), 1e-3)
    drive = law.respond([[0.0, 1e3, 1e3, 0.0, -1e3, 0.0]])[0][0]
    assert drive[1] == drive[2] == high
    assert drive[4] == low
    reached = model.static_response(drive[None])[0][0]
    np.testing.assert_allclose(reached[[3, 5]], 0.0, atol=1e-12)


def test_the_inverse_of_dynamics_builds_on_it():
    static = random_model(5)
    axes = AxesDynamics(axes=(Axis(resonance_hz=90.0, damping_ratio=0.2),) * 2)
    model = replace(static, dynamics=axes)
    t = np.arange(4000) * 1e-4
    goal = np.stack([2.0 * np.sin(20.0 * t) ** 2, np.sin(31.0 * t) ** 2])
    law = hammerstein.HammersteinInverse().design(model, 40.0, 1e-4)
    moved = discretise(axes, 1e-4).respond(model.static_response(law.drive_for(goal))[0])[0]
    np.testing.assert_allclose(moved[:, 200:-200], goal[:, 200:-200], atol=1e-6)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_slopes_hold_for_any_path(seed):
    """No chord of a path is steeper or flatter than what the block says of its slopes."""
    block, u = random_model(seed, 1).hysteresis, walk(seed, 1)
    v = block.respond(u)[0]
    moved = np.abs(np.diff(u[0])) > 1e-6
    chords = (np.diff(v[0]) / np.where(moved, np.diff(u[0]), 1.0))[moved]
    columns = block.slope_columns(0)
    assert columns.min() - 1e-9 <= chords.min()
    assert chords.max() <= columns.max() + 1e-9
    assert invertibility(block).invertible


def test_a_plane_that_stands_still_at_a_turn_has_no_inverse():
    """Relays that switch off the diagonal alone: right after a reversal none moves."""
    still = replace(random_model(1, 1), hysteresis=Preisach([-5.0], [5.0], [[np.eye(4, k=-1)]]))
    with pytest.raises(SimulationError, match="no inverse"):
        hammerstein.ExactInverse().design(still, 40.0, 1e-3)


def test_more_outputs_than_inputs_have_no_inverse():
    model = random_model(1, 1)
    cells = model.hysteresis.cells_um_per_v[0]
    both = replace(model, hysteresis=Preisach([-5.0], [5.0], [cells, cells]), outputs=("x", "y"),
                   dynamics=StaticDynamics(n_outputs=2))  # fmt: skip
    with pytest.raises(InputError, match="2 outputs"):
        hammerstein.ExactInverse().design(both, 40.0, 1e-3)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 3))
def test_determinants_of_the_outermost_slopes_bound_those_of_all(seed, rows):
    """A determinant is linear in each column, so that its ends are at outermost ones."""
    generator = np.random.default_rng(seed)
    columns = [generator.normal(size=(9, rows)) for _ in range(rows)]
    within = [generator.dirichlet(np.ones(9), 20) @ own for own in columns]
    ends = np.linalg.det(every_matrix([outermost(own) for own in columns]))
    found = np.linalg.det(np.stack(within, axis=2))
    assert ends.min() - 1e-9 <= found.min()
    assert found.max() <= ends.max() + 1e-9


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_outermost_columns_reach_as_far_as_all_in_every_direction(rows):
    """That is what the corners of a convex hull are; and they are columns that were given."""
    generator = np.random.default_rng(rows)
    columns = generator.exponential(size=(40, rows))
    corners = outermost(columns)
    directions = generator.normal(size=(rows, 100))
    np.testing.assert_array_equal((corners @ directions).max(axis=0), (columns @ directions).max(axis=0))
    assert {*map(tuple, corners)} <= {*map(tuple, columns)}


@dataclass(frozen=True, eq=False)
class TwoSlopes(Hysteresis):
    """A kind of somebody else that knows its slopes and has no rule for its inverse."""

    slopes: tuple[float, float]
    kind = "two_slopes"
    n_inputs = n_outputs = n_beside_weights = 1
    operators, weight_covariance, weights = ((1,),), None, ()

    def slope_columns(self, k):
        return np.array([[slope] for slope in self.slopes])

    def describe(self):
        return "two slopes"

    def _unused(self, *_):
        raise NotImplementedError

    rest = with_weights = file = _respond = _unused


@pytest.mark.parametrize(("slopes", "told"), [((1.0, 2.0), True), ((1.0, -2.0), False)])
def test_slopes_tell_whether_any_kind_has_an_inverse(slopes, told):
    assert invertibility(TwoSlopes(slopes)).invertible is told


def test_it_is_saved_and_loaded(tmp_path):
    model = random_model(11)
    model.save(tmp_path / "m.json")
    again = HammersteinModel.load(tmp_path / "m.json")
    assert again.hysteresis == model.hysteresis
    assert again.digest() == model.digest()


@pytest.mark.parametrize(
    ("numbers", "says"),
    [
        (([0.0], [0.0], [[np.eye(2)]]), "the lower one below"),
        (([0.0], [1.0], [[np.ones((2, 2))]]), "0 above the diagonal"),
        (([0.0], [1.0], [[np.eye(2) * np.nan]]), "finite"),
        (([0.0], [1.0], [[np.eye(41)]]), "1 to 40 cells"),
        (([0.0], [1.0], [[np.eye(2)], [np.eye(3)]]), "the same for all outputs"),
        (([0.0, 0.0], [1.0, 1.0], [[np.eye(2)]]), "row of 2 triangles"),
        (([0.0], [1.0], [[np.eye(2)]], [0.0, 0.0]), "1 finite voltages"),
    ],
)
def test_what_is_no_plane_is_refused(numbers, says):
    with pytest.raises(InputError, match=says):
        Preisach(*numbers)


def test_a_model_file_with_a_torn_triangle_is_refused():
    given = {"kind": "preisach", "low_v": [0.0], "high_v": [1.0], "cells_um_per_v": [[[[1.0], [1.0]]]]}
    with pytest.raises(ValueError, match="up to its diagonal"):
        hammerstein.hysteresis.preisach.PreisachFile.model_validate(given)


def lobed(u, cells=80):
    """Relays of a plane with a lobe aside of the diagonal, which no plays can have: by theory."""
    places = (np.arange(cells) + 0.5) / cells
    on, off = np.meshgrid(places, places, indexing="ij")
    lobe = np.tril(3.6 / cells * np.exp(-((on - 0.55) ** 2 + (off - 0.35) ** 2) / 0.1))
    return theory.relay_sum(u, 0.0, 100.0, lobe + 0.4 * np.eye(cells))


def measured(turns, end, seed=0, noise=0.02, law=lobed, samples=1500):
    """A stack from 0 to 100 V; the relays of one input switch at levels of 1.25 V."""
    angle = np.linspace(0.0, 2.0 * np.pi * turns, samples)
    sent = 50.0 * (1.0 - np.cos(angle)) * np.linspace(1.0, end, samples)
    sent = 1.25 * np.round(sent / 1.25)
    y = law(sent) + noise * np.random.default_rng(seed).standard_normal(samples)
    return Record([sent], y[None], 1e-3, ("u",), ("x",), f"{turns}-{end}.csv")


@pytest.mark.full
def test_identified_from_records_it_follows_what_plays_cannot():
    fitted, held = [measured(3, 0.3), measured(4, 0.6, 1)], [measured(5, 0.45, 2)]
    asked = Settings(hysteresis="preisach", dynamics="none", delay_samples=0, error_curve=False)
    model, fit = identify(fitted, asked, validation=held)
    block = model.hysteresis
    assert isinstance(block, Preisach)
    ours, plays = (fit.validation[kind].nrmse_percent[0] for kind in ("static_hysteresis", "classical"))
    assert ours < 0.1 * plays
    assert fit.invertible
    assert not any("lower bound" in note for note in fit.notes)  # the least slope of the truth is 0.4 um/V
    assert min(cells.min() for row in block.cells_um_per_v for cells in row) >= 0.0
    law = hammerstein.ExactInverse().design(model, (0.0, 100.0), 1e-3)
    goal = 20.0 * np.sin(np.linspace(0.0, 6.0, 300))[None] ** 2
    np.testing.assert_allclose(model.static_response(law.respond(goal)[0])[0], goal, atol=1e-9)


def test_the_first_rise_of_plays_that_were_never_driven_is_followed():
    """It goes through relays that switch off below the range: a plane over the range alone has none."""

    def plays(sent):
        return theory.prandtl_ishlinskii([sent], [[R]], [[W]])[0]

    fitted = [measured(n, end, n, 0.0, plays) for n, end in ((3, 0.3), (4, 0.6))]
    asked = Settings(hysteresis="preisach", dynamics="none", delay_samples=0, error_curve=False)
    model, fit = identify(fitted, asked, validation=[measured(5, 0.45, 5, 0.0, plays)])
    assert model.hysteresis.low_v[0] == pytest.approx(-model.hysteresis.high_v[0])
    assert fit.validation["static_hysteresis"].nrmse_percent[0] < 0.2


def test_the_number_of_operators_is_the_side_of_its_plane():
    asked = Settings(hysteresis="preisach", dynamics="none", delay_samples=0, error_curve=False, operators=7)
    model, fit = identify([measured(3, 0.3), measured(4, 0.6, 1)], asked)
    assert model.hysteresis.cells_um_per_v[0][0].shape == (7, 7)
    assert any("7 x 7 cells" in note for note in fit.notes)


def test_its_describing_function_is_the_first_harmonic_of_relays():
    """Of a sine at levels, about the working point: Fourier integral of the settled loop by theory."""
    n, amplitude, points = 40, 30.0, 4000
    cells = np.tril(np.random.default_rng(2).uniform(0.0, 0.05, (n, n))) + np.eye(n)
    block = Preisach([0.0], [100.0], [[cells]], [50.0])
    angle = 2.0 * np.pi * np.arange(2 * points) / points
    v = theory.relay_sum(50.0 + amplitude * np.sin(angle), 0.0, 100.0, cells, 6)[points:]
    expected = 2j * np.mean(v * np.exp(-1j * angle[points:])) / amplitude
    found = block.to_describing_function().describing_function(amplitude)
    assert found == pytest.approx(expected, rel=3e-3)
    assert found.imag < 0.0
    with pytest.raises(InputError, match="one pair"):
        random_model(1).hysteresis.to_describing_function()
