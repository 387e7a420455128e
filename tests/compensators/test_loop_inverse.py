"""Compensation of hysteresis in the loop: on the path by the printed equations, on a stream, and learned."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

import hammerstein
from hammerstein import HammersteinModel
from hammerstein.compensators.drive_file import Terms, compensation_of
from hammerstein.dynamics import (
    ElastoSlip,
    ElectromechanicalDynamics,
    FeedbackBlock,
    FeedbackHysteresisDynamics,
    StackAxis,
    on_grid,
)
from hammerstein.dynamics.feedback_block import InputProducts
from hammerstein.errors import InputError, SimulationError
from hammerstein.hysteresis import Pair, PrandtlIshlinskii

TIME_S = 1e-4
STOPS = ((0.3, 0.9), (0.2, 3.0), (0.1, 12.0))
NUMBERS = {"mass_kg": 0.5, "damping_ns_per_m": 60.0, "capacitance_uf": 2.0, "force_n_per_v": 1.2}
STIFF = (3.16, 1.9)


def stacks(soft=1.0, delay_s=0.0, rest_v=None):
    """Two stacks of 400 and 310 Hz, the second with twice the hysteresis."""
    axes = []
    for factor, stiffness in zip((soft, 2.0 * soft), STIFF, strict=True):
        slips = tuple(ElastoSlip(stiffness_v_per_uc=factor * k, threshold_uc=r) for k, r in STOPS)
        axes.append(StackAxis(**NUMBERS, stiffness_n_per_um=stiffness, stops=slips))
    straight = [[Pair([0.0], [float(i == k)]) for k in range(2)] for i in range(2)]
    dynamics = ElectromechanicalDynamics(axes=tuple(axes), input_delay_s=delay_s)
    return HammersteinModel("stacks", PrandtlIshlinskii(straight), dynamics, 30.0, ("a", "b"), ("x", "y"))


def path(samples=3000):
    """Two axes from rest, near the resonances' feet, and back to rest [um]."""
    t = np.arange(samples) * TIME_S
    swell = np.sin(np.pi * np.clip(t / t[-1], 0.0, 1.0)) ** 3
    waves = 4.0 * np.sin(2 * np.pi * 70.0 * t), 3.0 * np.sin(2 * np.pi * 45.0 * t + 1.0)
    return swell * np.array(waves)


def test_a_period_that_begins_away_from_rest_is_followed():
    """A cosine is a sine a quarter later; a jump to its beginning would end at the range."""
    turn = 2 * np.pi * 50.0 * np.arange(200) * TIME_S
    model = stacks()
    law = hammerstein.HammersteinInverse().design(model, 30.0, TIME_S)
    wanted = np.stack([1.5 * np.cos(turn), np.cos(turn + 0.7)])
    moved = model.simulate(law.drive_for(np.tile(wanted, 12)), TIME_S).position_um[:, -200:]
    assert (moved - wanted).std() < 2e-3 * wanted.std()
    with pytest.raises(SimulationError, match=r"begins 0.6 um away(.|\n)*--lead-in \(0.00"):
        compensation_of(model, 0.4 * np.tile(wanted, 3), "hammerstein_inverse", {}, Terms())


def charge(s, plays, c, stops):
    """Root q of q + C V_h(q) = s, from the plays before."""

    def left(q):
        after = [max(q - r, min(q + r, p)) for (_, r), p in zip(stops, plays, strict=True)]
        return q + c * sum(w * (q - p) for (w, _), p in zip(stops, after, strict=True)) - s

    return brentq(left, -1e3, 1e3, xtol=1e-9)


def moved(u, factors=(1.0, 2.0), fine=20):
    """Positions (2, N) by the printed equations: charge by a root, motion by a fine march."""
    found = np.zeros_like(u)
    for axis, (factor, stiff) in enumerate(zip(factors, STIFF, strict=True)):
        m, d, c, t = (NUMBERS[k] for k in ("mass_kg", "damping_ns_per_m", "capacitance_uf", "force_n_per_v"))
        stops = [(factor * k, r) for k, r in STOPS]
        # x [um], x' [um/s]: M x'' + D x' + K x = T V_z, K in N/um
        a = np.array([[0.0, 1.0], [-1e6 * stiff / m, -d / m]])
        step = expm(TIME_S / fine * np.block([[a, np.array([[0.0], [1e6 * t / m]])], [np.zeros((1, 3))]]))
        x, plays = np.zeros(2), [0.0] * len(stops)
        for k, value in enumerate(u[axis]):
            found[axis, k] = x[0]
            for _ in range(fine):
                q = charge(c * value + t * x[0], plays, c, stops)
                plays = [max(q - r, min(q + r, p)) for (_, r), p in zip(stops, plays, strict=True)]
                # V_z = (q - T x) / C
                x = step[:2, :2] @ x + step[:2, 2] * (q - t * x[0]) / c
    return found


def law_of(model, **options):
    return hammerstein.HammersteinInverse(**options).design(model, 30.0, TIME_S)


def test_the_model_stands_on_the_path():
    """To a thousandth of the path, where the gain alone misses a third of it."""
    model, wanted = stacks(), path()
    plain = hammerstein.NoCompensation().design(model, 30.0, TIME_S)
    before, after = (
        model.simulate(law.drive_for(wanted), TIME_S).position_um for law in (plain, law_of(model))
    )
    assert (before - wanted).std() > 0.03 * wanted.std()
    assert (after - wanted).std() < 1e-3 * wanted.std()


@pytest.mark.parametrize("moves", [1, 2])
def test_the_model_stands_on_the_path_however_often_its_hysteresis_moves_in_a_sample(moves):
    """The loop of stacks on its grid, where w is linear within a sample; and one whose w is held."""
    twice = on_grid(stacks().dynamics, TIME_S)
    assert isinstance(twice, FeedbackBlock)
    assert twice.moves == 2
    rows = {name: getattr(twice, name) for name in "ABCDEFGH"}
    if moves == 1:
        h, q = twice.H.shape
        both = twice.E[:, :q] + twice.E[:, q:]
        rows = rows | {"E": both, "F": twice.F[:h], "G": twice.G[:h], "H": np.zeros((0, q))}
    dynamics = FeedbackHysteresisDynamics.of(twice.hysteresis, sample_time_s=TIME_S, **rows)
    model, wanted = replace(stacks(), dynamics=dynamics), path()
    found = model.simulate(law_of(model).drive_for(wanted), TIME_S).position_um
    assert (found - wanted).std() < 1e-3 * wanted.std()


def test_waves_beyond_the_resonances_are_followed_where_passes_alone_lead_away():
    """Ten times the hysteresis, waves up to 700 Hz: a path known as a whole takes the steps it needs."""
    t = np.arange(1200) * TIME_S
    turns = 2 * np.pi * np.arange(20.0, 700.0, 20.0)[None, :, None] * t
    phases = np.random.default_rng(3).uniform(0.0, 2 * np.pi, size=(2, turns.shape[1], 1))
    waves = np.sin(np.pi * t / t[-1]) ** 2 * np.sin(turns + phases).sum(axis=1)
    wanted = waves / waves.std(axis=1, keepdims=True)
    model = stacks(soft=10.0)
    law = hammerstein.HammersteinInverse().design(model, 300.0, TIME_S)
    found = model.simulate(law.drive_for(wanted), TIME_S).position_um
    assert (found - wanted).std() < 1e-3 * wanted.std()
    assert not law.drive_for(np.zeros((2, 50))).any()


@pytest.mark.full
def test_the_printed_equations_stand_on_the_path():
    """Goldfarb and Celanovic's, marched finely: what is left is w held over a sample, less than a percent."""
    wanted = path(1200)
    found = moved(law_of(stacks()).drive_for(wanted))
    assert (found - wanted).std() < 0.03 * wanted.std()


@pytest.mark.full
@pytest.mark.parametrize("options", [{}, {"filter_hz": 900.0}], ids=["plain", "filtered"])
def test_a_stream_in_parts_is_the_whole_to_the_last_bit(options):
    law, wanted = law_of(stacks(delay_s=2.5e-4), **options), path(400)
    whole, end = law.respond(wanted)
    first, state = law.respond(wanted[:, :123])
    state = law.restore(json.loads(json.dumps(state.as_dict())))
    parts, steps = [first], []
    for sample in wanted[:, 123:].T:
        u, state = law.step(sample, state)
        steps.append(u)
    assert np.array_equal(np.hstack([*parts, np.array(steps).T]), whole)
    after = path(800)[:, 400:]  # a memory may also keep what it does not use any more
    assert np.array_equal(law.respond(after, state)[0], law.respond(after, end)[0])


def test_a_delay_and_a_filter_are_looked_through():
    model, wanted = stacks(delay_s=2.5e-4), path()
    law = law_of(model, filter_hz=1500.0)
    found = model.simulate(law.drive_for(wanted), TIME_S).position_um
    assert (found - wanted).std() < 1e-3 * wanted.std()


def test_without_stops_it_is_the_inverse_of_the_linear_model():
    """No pass is needed: the first drive is exact."""
    law = law_of(stacks(soft=1e-9))
    wanted = path()
    found = stacks(soft=1e-9).simulate(law.drive_for(wanted), TIME_S).position_um
    np.testing.assert_allclose(found, wanted, atol=1e-8 * np.abs(wanted).max())


def test_what_it_cannot_do_is_refused_by_name():
    with pytest.raises(InputError, match="hysteresis in the loop needs"):
        law_of(stacks(), preview_s=0.0)
    model = stacks()
    limits = hammerstein.blocks.driving.DriveRange.of(30.0, model, [5.0, 0.0])
    with pytest.raises(InputError, match="from rest at the working point"):
        hammerstein.HammersteinInverse().design(model, limits, TIME_S)


@pytest.mark.full
def test_compensate_gives_voltages_and_the_reach_of_the_loop():
    """A path beyond what the balance of the stops lets the drive's 10 V do is refused with that reach."""
    model = stacks()
    found = model.compensate(0.5 * path())
    assert found.shortfall.complete
    assert "in the loop is inverted in" in " ".join(found.statements())
    with pytest.raises(SimulationError, match="out of reach"):
        model.compensate(20.0 * path())
    reached = found.reach.alone_um[:, 1]
    for axis, (factor, stiff) in enumerate(zip((1.0, 2.0), STIFF, strict=True)):
        soft = NUMBERS["capacitance_uf"] + NUMBERS["force_n_per_v"] ** 2 / stiff
        end = brentq(lambda q: sum(factor * k * min(q, r) for k, r in STOPS) + q / soft - 10.0, 0.0, 1e4)  # noqa: B023
        expected = NUMBERS["force_n_per_v"] / stiff * end / soft
        assert reached[axis] == pytest.approx(expected, rel=1e-6)


@pytest.mark.full
def test_a_scenario_learns_on_its_inverse(tmp_path):
    """The true stack has 1.3 times the hysteresis of the model: five trials leave a tenth of the first."""
    true, known = tmp_path / "true.json", tmp_path / "known.json"
    stacks(1.3).save(true)
    stacks().save(known)
    asked = {
        "question": "What do trials leave?",
        "actuator": str(true),
        "reference": {"kind": "sine", "amplitude_um": 1.5, "frequency_hz": 50.0},
        "measure": {"settle_cycles": 2, "measured_cycles": 4},
        "compensators": [
            {"label": f"trial {k}", "law": "learned", "model": str(known), "trial": k} for k in (1, 5)
        ],
    }
    report = hammerstein.run(asked)
    rms = [max(row.rms_true_um for row in report.rows if row.compensator == f"trial {k}") for k in (1, 5)]
    assert rms[1] < 0.1 * rms[0]


def test_passes_that_lead_away_are_refused():
    """x+ = x / 2 + u + w with w = 3 u^3, which no gain of the plays tells of."""
    one = {name: [[1.0]] for name in "BCEG"} | {"A": [[0.5]], "D": [[0.0]], "F": [[0.0]]}
    curved = InputProducts(np.array([[3000.0]]), np.array([10.0]), np.array([[0, 0, 0]]))
    gamma = PrandtlIshlinskii([[Pair([0.0, 1.0], [0.01, 0.01])]])
    dynamics = FeedbackHysteresisDynamics.of(gamma, sample_time_s=TIME_S, products=curved, **one)
    straight = PrandtlIshlinskii([[Pair([0.0], [1.0])]])
    model = HammersteinModel("curved", straight, dynamics, 10.0, ("u",), ("x",))
    with pytest.raises(SimulationError, match="they diverge on a trial path"):
        hammerstein.HammersteinInverse().design(model, 10.0, TIME_S)


@pytest.mark.full
def test_a_square_wave_is_told_the_filter_with_which_it_is_within_reach():
    """A jump beyond the resonance asks for kilovolts; without hysteresis in the loop the same is named."""
    slips = tuple(ElastoSlip(stiffness_v_per_uc=k, threshold_uc=r) for k, r in STOPS)
    axis = StackAxis(**NUMBERS, stiffness_n_per_um=STIFF[0], stops=slips)
    straight, dynamics = PrandtlIshlinskii([[Pair([0.0], [1.0])]]), ElectromechanicalDynamics(axes=(axis,))
    model = HammersteinModel("stack", straight, dynamics, 30.0, ("a",), ("x",))
    drive = model.instruments.drive.model_copy(update={"sample_time_s": TIME_S, "range_v": (-20.0, 20.0)})
    model = replace(model, instruments=model.instruments.model_copy(update={"drive": drive}))
    wanted = np.where(np.arange(700) % 500 < 250, 3.0, -3.0)[None] * (np.arange(700) >= 100)
    terms = Terms(beyond_records=True)
    with pytest.raises(SimulationError) as refused:
        compensation_of(model, wanted, "hammerstein_inverse", {}, terms)
    named = re.search(r"--filter-hz (\d+) \((.*?) um\)", str(refused.value))
    clipped = re.search(r"--clip \((.*?) um\)", str(refused.value))
    assert named
    assert clipped
    found = compensation_of(model, wanted, "hammerstein_inverse", {"filter_hz": float(named[1])}, terms)
    left = np.abs(found.shortfall.error_um).max()
    assert left == pytest.approx(float(named[2]), rel=0.06)
    assert left < 0.6 * float(clipped[1])


def test_of_drives_that_meet_a_path_one_within_the_range_is_taken(monkeypatch):
    """Another one swings far between the samples: cut at the range, it missed a path."""
    law, small = law_of(stacks()), 0.1 * np.ones((2, 3000))
    assert len(law.loops) > 1
    first = law.loops[0]
    monkeypatch.setattr(
        type(first),
        "solved",
        lambda self, known: (1e-6, 1e4 * small) if self is first else (5e-5, small),
    )
    np.testing.assert_allclose(law.drive_for(path()), small)
