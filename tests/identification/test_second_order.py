"""Resonance, damping, creep and delay, found together with the static block."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import theory
from scipy.signal import cont2discrete, lfilter
from theory_linear import second_order_step

from hammerstein.dynamics import AxesDynamics, Axis, CreepMode, StaticDynamics, discretise
from hammerstein.identification import play_candidates
from hammerstein.identification.excitation import several_rates
from hammerstein.identification.fit import Task
from hammerstein.identification.fit_report import axis_statements
from hammerstein.identification.identify import identify
from hammerstein.identification.linear import axis_fit
from hammerstein.identification.linear.axis_fit import AxisFit, fit_axis, refine
from hammerstein.identification.linear.axis_task import AxisShape, AxisTask, axis_of
from hammerstein.identification.output_dynamics import OutputDynamics
from hammerstein.identification.play_candidates import dynamics_of, fit_axes
from hammerstein.identification.score import SensorModel
from hammerstein.identification.search import _part_of_a_sample
from hammerstein.identification.settings import Settings
from hammerstein.identification.static.regressors import InitialState
from hammerstein.identification.static.static_block import fit_static
from hammerstein.model import HammersteinModel
from hammerstein.records.record import Record
from hammerstein.signals import Multisine, Sine

T = 5e-5
R = np.array([0.0, 1.0, 3.0, 6.0])
W = np.array([[[4.0, 0.5, 1.0, 0.5], [0.3, -0.1, 0.05, 0.1]], [[-0.2, 0.1, 0.1, 0.05], [3.5, 0.8, 0.4, 0.3]]])
AXES = ((280.0, 0.12), (310.0, 0.1))
SENSOR_HZ = 2000.0


def lagged(v, resonance_hz, damping, creep=(), sample_time_s=T, sensor_hz=SENSOR_HZ):
    """One axis and its sensor by SciPy's exact zero-order hold, not by ours."""
    w, s = 2.0 * np.pi * resonance_hz, 2.0 * np.pi * sensor_hz
    n = len(creep)
    a = np.zeros((3 + n, 3 + n))
    a[:2, :2] = [[0.0, w], [-w, -2.0 * damping * w]]
    b = np.zeros((3 + n, 1))
    b[1] = w
    position = np.zeros((1, 3 + n))
    position[0, 0] = 1.0
    for i, (gain, time_s) in enumerate(creep):
        a[2 + i, 0], a[2 + i, 2 + i], position[0, 2 + i] = 1.0 / time_s, -1.0 / time_s, gain
    a[-1] = s * position
    a[-1, -1] = -s
    c = np.zeros((1, 3 + n))
    c[0, -1] = 1.0
    a, b, *_ = cont2discrete((a, b, c, np.zeros((1, 1))), sample_time_s)
    poles, modes = np.linalg.eig(a)
    into, out = np.linalg.solve(modes, b)[:, 0], (c @ modes)[0]
    parts = [
        o * i * lfilter([0.0, 1.0], [1.0, -pole], v) for o, i, pole in zip(out, into, poles, strict=True)
    ]
    return np.real(np.sum(parts, axis=0))


def record_of(u, noise, generator, axes=AXES, delay=0, **keywords):
    late = np.hstack([np.zeros((2, delay)), u[:, : u.shape[1] - delay]])
    v = theory.prandtl_ishlinskii(late, [[R] * 2] * 2, W)
    y = np.array([lagged(row, *axis, **keywords) for row, axis in zip(v, axes, strict=True)])
    return Record(u, y + noise * generator.standard_normal(y.shape), keywords.get("sample_time_s", T))


def campaign(noise=0.04, seed=0, frequencies=(20.0, 100.0, 250.0, 400.0), **keywords):
    """Sines of 10 V on one input at a time, from rest."""
    generator = np.random.default_rng(seed)
    records = []
    for k in range(2):
        for f in frequencies:
            u = np.zeros((2, 1500))
            u[k] = 10.0 * np.sin(2.0 * np.pi * f * T * np.arange(1500))
            records.append(record_of(u, noise, generator, **keywords))
    return records


def guessed(records, delay_samples=0, dynamics="second_order"):
    """Axes and delay of records from rest, before they are fitted."""
    given = Settings(
        dynamics=dynamics, sensor_bandwidth_hz=SENSOR_HZ, delay_samples=delay_samples, error_curve=False
    )
    starts = (InitialState("rest"),) * len(records)
    guess = play_candidates.guess_of(records, starts, given, lambda _: None)
    return guess, Task(tuple(records), starts, [[R] * 2] * 2, guess.delay_samples, given, lambda _: None)


def fitted(records, creep=(), **keywords):
    """creep : gain and time constant of each slow mode to begin with."""
    guess, task = guessed(records, **keywords)
    modes = tuple(CreepMode(gain=gain, time_constant_s=time_s) for gain, time_s in creep)
    near = [axis.model_copy(update={"creep": modes}) for axis in guess.axes]
    fits = fit_axes(task, task.thresholds_v, near)
    return guess._replace(axes=tuple(fit.axis for fit in fits), fits=fits)


def test_resonance_damping_and_weights_come_back_from_noisy_sines():
    records = campaign()
    fit = fitted(records)
    for axis, (resonance_hz, damping) in zip(fit.fits, AXES, strict=True):
        assert axis.axis.resonance_hz == pytest.approx(resonance_hz, rel=1e-4)
        assert axis.axis.damping_ratio == pytest.approx(damping, rel=1e-3)
        assert axis.rms_um == pytest.approx(0.04, rel=0.05)
        assert axis.static_rms_um > 5.0
    through = discretise(fit.dynamics, T, SENSOR_HZ)
    static = fit_static(records, [[R] * 2] * 2, through=[through] * len(records))
    found = np.array([[pair.weights_um_per_v for pair in row] for row in static.hysteresis.pairs])
    assert np.abs(found - W).max() < 0.01


def test_standard_errors_are_of_the_size_of_the_errors():
    scores = []
    for seed in range(6):
        records = campaign(0.2, seed, frequencies=(100.0, 250.0))
        starts = (InitialState("rest"),) * len(records)
        for o, truth in enumerate(AXES):
            task = AxisTask(tuple(records), starts, (R, R), o, AxisShape(), 0, SensorModel(SENSOR_HZ))
            point = refine(task, np.log(truth))
            scores += list((point.x - np.log(truth)) / point.errors)
    assert 0.5 < np.sqrt(np.mean(np.square(scores))) < 1.6  # 24 normal scores


@pytest.mark.parametrize("axes", [((30.0, 0.3), (45.0, 0.05)), ((900.0, 0.02), (2500.0, 0.6))])
def test_search_needs_no_starting_values(axes):
    fit = fitted(campaign(0.01, axes=axes))
    for axis, (resonance_hz, damping) in zip(fit.axes, axes, strict=True):
        assert axis.resonance_hz == pytest.approx(resonance_hz, rel=1e-3)
        assert axis.damping_ratio == pytest.approx(damping, rel=1e-2)


def test_a_resonance_is_found_that_shows_only_late_in_long_records(monkeypatch):
    for module, name in ((play_candidates, "GUESS_SAMPLES"), (axis_fit, "COUNTED_SAMPLES")):
        monkeypatch.setattr(module, name, getattr(module, name) // 4)  # what is long, in less time
    slow, generator, records = 10_000, np.random.default_rng(4), []
    for k in range(2):
        u = np.zeros((2, slow + 4000))
        u[k, :slow] = 10.0 * np.sin(2.0 * np.pi * 1.5 * T * np.arange(slow))
        u[k, slow:] = generator.uniform(-2.0, 2.0, 500).repeat(8)
        records.append(record_of(u, 0.3, generator, axes=((700.0, 0.025), (740.0, 0.025))))
    for axis, resonance_hz in zip(guessed(records)[0].axes, (700.0, 740.0), strict=True):
        assert [axis.resonance_hz, axis.damping_ratio] == pytest.approx([resonance_hz, 0.025], rel=0.1)


def test_delay_is_told_from_the_lag_of_the_axes():
    fit = fitted(campaign(delay=2), delay_samples=None)
    assert fit.delay_samples == 2
    assert fit.axes[0].resonance_hz == pytest.approx(280.0, rel=1e-3)


@pytest.mark.parametrize("delay", [1, 4])
def test_no_low_pass_beside_a_resonance_stands_in_for_a_delay(delay):
    """Beside a resonance of 280 Hz, a low-pass of 0.2 ms leaves hardly more than a delay of four samples."""
    guess, _ = guessed(campaign(delay=delay), delay_samples=None, dynamics="auto")
    assert guess.delay_samples == delay
    assert [axis.lag_s for axis in guess.axes] == [None, None]


def test_an_axis_keeps_the_dynamics_tried_where_they_do_not_help():
    """What was tried is said of it, though the model has none."""
    u = np.zeros((2, 2000))
    u[0] = 10.0 * np.sin(2.0 * np.pi * np.arange(2000) / 1000)
    guess, _ = guessed([record_of(u, 0.04, np.random.default_rng(0), sample_time_s=0.01)], dynamics="auto")
    assert all(axis.lag_s or axis.resonance_hz for axis in guess.axes)


@pytest.mark.full
def test_a_part_of_a_sample_of_delay_is_told():
    late, parts, generator = 19, 8, np.random.default_rng(3)  # two samples and three eighths
    records = []
    for record in campaign(0.0):
        u = np.repeat(record.u_v, parts, axis=1)
        fine = record_of(u, 0.0, generator, delay=late, sample_time_s=T / parts)
        y = fine.y_um[:, ::parts]
        records.append(Record(record.u_v, y + 0.02 * generator.standard_normal(y.shape), T))
    guess, task = guessed(records, delay_samples=None)
    assert guess.delay_samples == pytest.approx(late / parts, abs=0.05)
    fits = fit_axes(task, task.thresholds_v, guess.axes)
    whole = fit_axes(replace(task, delay_samples=2.0), task.thresholds_v, guess.axes)
    for o, (resonance_hz, damping) in enumerate(AXES):
        axis = fits[o]
        assert axis.axis.resonance_hz == pytest.approx(resonance_hz, rel=1e-3)
        assert axis.axis.damping_ratio == pytest.approx(damping, rel=1e-2)
        assert axis.rms_um == pytest.approx(0.02, rel=0.05)
        assert whole[o].rms_um > 1.5 * axis.rms_um


def test_creep_comes_back_from_a_slow_record_beside_fast_ones():
    creep = ((0.04, 0.5), (0.06, 8.0))
    fast = campaign(0.01, frequencies=(50.0, 250.0, 400.0), creep=creep)
    slow = []
    for k in range(2):
        u = np.zeros((2, 4000))
        time_s = 0.01 * np.arange(4000)
        u[k] = 8.0 * np.sign(np.sin(2.0 * np.pi * time_s / 20.0 + 0.1)) + 1.5 * np.sin(2.0 * np.pi * time_s)
        slow.append(record_of(u, 0.01, np.random.default_rng(k), creep=creep, sample_time_s=0.01))
    fit = fitted([*fast, *slow], creep=((0.02, 2.3), (0.02, 7.0)))
    for axis in fit.axes:
        modes = sorted(axis.creep, key=lambda mode: mode.time_constant_s)
        assert [mode.gain for mode in modes] == pytest.approx([0.04, 0.06], rel=0.02)
        assert [mode.time_constant_s for mode in modes] == pytest.approx([0.5, 8.0], rel=0.02)


def test_a_resonance_shows_whatever_the_size_of_the_motion():
    records = [Record(r.u_v, 2.0**-13 * r.y_um, T) for r in campaign(0.2, frequencies=(100.0, 250.0))]
    starts = (InitialState("rest"),) * len(records)
    task = AxisTask(tuple(records), starts, (R, R), 0, AxisShape(), 0, SensorModel(SENSOR_HZ))
    assert fit_axis(task, np.log(AXES[0])).excited


def test_a_slow_record_tells_no_resonance():
    u = np.zeros((2, 2000))
    u[0] = 10.0 * np.sin(2.0 * np.pi * np.arange(2000) / 1000)
    u[1] = 10.0 * np.sin(2.0 * np.pi * np.arange(2000) / 800)
    fit = fitted([record_of(u, 0.04, np.random.default_rng(0), sample_time_s=0.01)])
    assert not any(axis.identified for axis in fit.fits)
    statements = list(axis_statements(("x", "y"), fit.fits))
    assert statements[0].startswith("resonance and damping of x: dynamics do not lower the error")


def a_fit(resonance_hz, told, creep=(), creep_gain_errors=(), damping_error_percent=1.0):
    axis = Axis(resonance_hz=resonance_hz, damping_ratio=0.1, creep=creep)
    return AxisFit(axis, 0.1, damping_error_percent, creep_gain_errors, 0.1 if told else 0.99, 1.0)


def test_an_axis_that_is_not_told_passes_its_input_unchanged():
    dynamics = dynamics_of([a_fit(100.0, False), a_fit(50.0, True)])
    alone = discretise(AxesDynamics(axes=(a_fit(50.0, True).axis,)), 1e-3)
    response = discretise(dynamics, 1e-3).response([0.0, 20.0, 80.0])
    assert np.abs(response[:, 0, 0] - 1.0).max() < 1e-12
    assert np.abs(response[:, 1, 1] - alone.response([0.0, 20.0, 80.0])[:, 0, 0]).max() < 1e-9
    assert np.abs(response[:, 0, 1]).max() == 0.0
    assert isinstance(dynamics_of([a_fit(50.0, True)]), AxesDynamics)


def test_unsure_damping_and_creep_are_stated():
    slow = (CreepMode(gain=0.01, time_constant_s=300.0),)
    said = list(axis_statements(("x",), [a_fit(50.0, True, slow, (0.02,), damping_error_percent=40.0)]))
    assert said[0] == "damping of x: standard error 40 %"
    assert said[1].startswith(
        "creep of x with a time constant of 300 s: gain 0.01 ± 0.02; record a step that is held for 3000 s"
    )
    none = (CreepMode(gain=1e-5, time_constant_s=0.03),)
    (said,) = axis_statements(("x",), [a_fit(50.0, True, none, (3e-5,))])
    assert said.endswith("gain 1e-05 ± 3e-05; the records show none; ask for fewer modes")


def test_a_lag_that_is_mostly_error_is_stated():
    """A low-pass far above the sample rate, beside a resonance that is known."""
    axis = Axis(resonance_hz=50.0, damping_ratio=0.1, lag_s=1e-5)
    sure = AxisFit(axis, 0.1, 1.0, (), 0.1, 1.0, lag_error_percent=10.0)
    assert list(axis_statements(("x",), [sure])) == []
    said = list(axis_statements(("x",), [replace(sure, lag_error_percent=80.0)]))
    assert said[-1] == "lag of x: 10 us ± 8 us"
    said = list(axis_statements(("x",), [replace(sure, lag_error_percent=400.0)]))
    assert said[-1] == "lag of x: not identifiable from the records (best fit: 10 us)"


@pytest.mark.parametrize("sensor_hz", [None, 2000.0])
@pytest.mark.parametrize("sample_time_s", [T, 0.01])
def test_quick_paths_are_those_of_the_model(sensor_hz, sample_time_s):
    x = np.concatenate([np.log([280.0, 0.12]), [0.05, np.log(0.02), -0.01, np.log(30.0)]])
    task = AxisTask((), (), (R,), 0, AxisShape(creep_modes=2), 0, SensorModel(sensor_hz))
    for path, dynamics in (
        (task.path(x, sample_time_s), AxesDynamics(axes=(axis_of(task.shape, x),))),
        (task.sensor_path(sample_time_s), StaticDynamics(n_outputs=1)),
    ):
        wanted = discretise(dynamics, sample_time_s, sensor_hz).response([0.0, 3.0, 40.0])[:, -1]
        assert np.abs(path.response([0.0, 3.0, 40.0])[:, 0] - wanted).max() < 1e-9


def test_derivatives_are_those_of_the_output():
    x = np.log([280.0, 0.12])
    x = np.concatenate([x, [0.05, np.log(0.02)]])
    records = campaign(0.0)
    task = AxisTask(
        tuple(records),
        (InitialState("rest"),) * 8,
        (R, R),
        0,
        AxisShape(creep_modes=1),
        0,
        SensorModel(SENSOR_HZ),
    )
    slopes = np.arange(1.0, 9.0)
    columns = np.random.default_rng(0).standard_normal((8, 300))
    block = task.derivatives(x, slopes, T)
    rows, _ = block.respond(columns, block.settled(np.zeros(8)))
    for i in range(4):
        step = 1e-4 * np.eye(4)[i]
        ahead, behind = (task.path(x + s * step, T).respond(slopes @ columns)[0][0] for s in (1.0, -1.0))
        wanted = (ahead - behind) / 2e-4
        assert np.abs(rows[i] - wanted).max() < 1e-5 * np.abs(wanted).max()


def test_parameters_stay_within_what_the_records_can_show():
    records = campaign(0.0)[:1]
    task = AxisTask(
        tuple(records), (InitialState("rest"),), (R, R[:0]), 0, AxisShape(), 0, SensorModel(SENSOR_HZ)
    )
    found = axis_of(task.shape, refine(task, np.log([1e5, 1e-6])).x)
    assert found.resonance_hz <= 0.45 / T
    assert found.damping_ratio >= 0.99e-4


def test_searches_that_meet_arrive_at_one_place():
    records = campaign()
    task = AxisTask(
        tuple(records), (InitialState("rest"),) * 8, (R, R), 0, AxisShape(), 0, SensorModel(SENSOR_HZ)
    )
    begins = [np.log(each) for each in ((320.0, 0.15), (240.0, 0.15), (5000.0, 0.03))]
    (found,) = axis_fit.arrived(lambda x: task, begins, 1e-5)
    assert np.abs(np.exp(found.x) / AXES[0] - 1.0).max() < 0.02


def test_a_search_is_given_up_where_it_stays_far_behind_alone(monkeypatch):
    """Places as (frequency, damping, error) after each step of four searches."""
    trails = [
        [(300.0, 0.1, 2.0), (280.0, 0.1, 1.0)],
        [(600.0, 0.1, 1.6)] * 3 + [(500.0, 0.1, 1.4)] * 5,
        [(700.0, 0.1, 1.6)] * 5 + [(800.0, 0.1, 0.1)],
        [(290.0, 0.11, 1.0005), (290.0, 0.11, 0.1)],
    ]
    steps = [[SimpleNamespace(x=np.log([f, z]), rms=rms) for f, z, rms in trail] for trail in trails]
    monkeypatch.setattr(axis_fit, "refined", lambda task, x, enough: iter(steps[x]))
    task = SimpleNamespace(shape=AxisShape())
    assert axis_fit.arrived(lambda x: task, range(4), 1e-5) == [steps[0][-1], steps[1][-1]]


def test_the_oracle_of_these_tests_is_the_step_response_of_theory():
    step = lagged(np.ones(400), 280.0, 0.12, sensor_hz=1e6)
    assert np.abs(step - second_order_step(T * np.arange(400), 280.0, 0.12)).max() < 1e-3


def test_a_delay_at_which_nothing_is_left_is_kept():
    """Beside it the squares are beyond any number of their own ratio."""

    def left(delay, _):
        return [0.0 if delay == 3.0 else 1e160], np.zeros(1)

    tried = {delay: left(delay, ()) for delay in (2.0, 3.0, 4.0)}
    assert _part_of_a_sample(left, tried, 3.0) == 3.0


def settled_cycles(*rates_hz):
    """Last eight of 24 cycles of 10 V behind a resonance of 2 Hz, one record a rate: it rings no more."""
    records, time_s = [], 5e-3
    for hz in rates_hz:
        period = round(1.0 / hz / time_s)
        u = np.tile(10.0 * np.sin(2.0 * np.pi * np.arange(period) / period), (1, 24))
        y = lagged(theory.prandtl_ishlinskii(u, [[R]], W[:1, :1])[0], 2.0, 0.1, sample_time_s=time_s)
        noisy = y + 0.01 * np.random.default_rng(0).standard_normal(y.shape)
        records.append(Record(u[:, -8 * period :], [noisy[-8 * period :]], time_s))
    return tuple(records)


@pytest.mark.parametrize(("rates_hz", "told"), [((1.0,), False), ((1.0, 1.25), False), ((1.0, 2.5), True)])
def test_a_resonance_among_the_harmonics_of_the_only_rate_is_not_told(rates_hz, told):
    """A settled loop holds multiples of its rate alone: any of them may be made by hysteresis as well."""
    records = settled_cycles(*rates_hz)
    starts = (InitialState("repeated"),) * len(records)
    fit = fit_axis(
        AxisTask(records, starts, (R,), 0, AxisShape(), 0, SensorModel(SENSOR_HZ)), np.log([1.9, 0.1])
    )
    assert fit.axis.resonance_hz == pytest.approx(2.0, rel=0.01)
    assert fit.identified is told
    said = [line for line in axis_statements(("x",), [fit]) if "first harmonics of the only rate" in line]
    assert bool(said) is not told


@pytest.mark.parametrize("seed", [10, 11, 12, 18])
def test_a_sine_and_a_slow_multisine_tell_a_resonance_whatever_its_phases(seed):
    """Hysteresis answers at the sums and differences of many lines; a resonance explains two numbers of them.

    The swings of these phases are alike in length; one set of phases in five lost the resonance.
    """
    t = T * np.arange(2000)
    sine = Sine(amplitude=10.0, frequency_hz=50.0, axis=1)
    multisine = Multisine(amplitude=10.0, lowest_hz=5.0, highest_hz=50.0, seed=seed)
    u = np.concatenate([shape.sample(t, 1)[0] for shape in (sine, multisine)])[None]
    assert not several_rates([Record(u, u, T)])
    y = lagged(theory.prandtl_ishlinskii(u, [[R]], W[:1, :1])[0], 280.0, 0.12)
    noisy = y + 0.04 * np.random.default_rng(seed).standard_normal(y.shape)
    task = AxisTask(
        (Record(u, [noisy], T),), (InitialState("rest"),), (R,), 0, AxisShape(), 0, SensorModel(SENSOR_HZ)
    )
    fit = fit_axis(task, np.log([270.0, 0.1]))
    assert fit.axis.resonance_hz == pytest.approx(280.0, rel=0.01)
    assert fit.identified


@pytest.mark.parametrize("outputs", [1, 2])
@pytest.mark.parametrize(("part", "late"), [(0.97, True), (0.99, False), (1.01, False)])
def test_a_delay_that_lowers_no_error_by_two_percent_is_left_out(monkeypatch, outputs, part, late):
    """Each of the outputs by so much, or one for another."""

    def built(task, guess):
        delay = guess.delay_samples
        rms_um = np.full(outputs, part if delay else 1.0) * [2.0, 0.5][:outputs]
        blocks = SimpleNamespace(chosen=SimpleNamespace(rms_um=rms_um))
        return SimpleNamespace(best=SimpleNamespace(blocks=blocks), delay=delay)

    monkeypatch.setattr(play_candidates, "_built_with", built)
    u = np.sin(np.arange(100.0) / 9.0)
    record = Record([u], [u] * outputs, T)
    task = Task((record,), (InitialState("rest"),), [[R]] * outputs, 1.0, Settings(), lambda _: None)
    guess = OutputDynamics((Axis(lag_s=1e-3),) * outputs, 1.0)
    assert bool(play_candidates.build_axes(task, guess).delay) == late


def crowded(noise, seed=0):
    """Two axes of 28 play operators with weights of both signs, each input driven alone from rest."""
    plays = HammersteinModel.load("duo_bimorph_dense").hysteresis.pairs
    r = np.append(0.18, plays[0][0].thresholds_v[1:])
    w = np.array([[pair.weights_um_per_v for pair in row] for row in plays])
    t, generator = T * np.arange(2000), np.random.default_rng(seed)
    wave = 10.0 * np.sin(2.0 * np.pi * 50.0 * t)
    drive = np.append(wave, Multisine(amplitude=10.0, lowest_hz=5.0, highest_hz=50.0, seed=1).sample(t, 1)[0])
    records = []
    for k in range(2):
        u = np.zeros((2, len(drive)))
        u[k] = drive
        v = theory.prandtl_ishlinskii(u, [[r] * 2] * 2, w)
        y = np.array([lagged(row, *axis) for row, axis in zip(v, AXES, strict=True)])
        records.append(Record(u, y + noise * generator.standard_normal(y.shape), T))
    return records


@pytest.mark.parametrize("seed", [0, 3])
def test_thresholds_and_axes_are_fitted_together(seed):
    """In turn, each makes up for what the other one lacks, and the search ends half way."""
    given = Settings(operators=20, dynamics="second_order", sensor_bandwidth_hz=SENSOR_HZ)
    model, fit = identify(crowded(0.02, seed), given.changed(creep_modes=0, delay_samples=0))
    for axis, (resonance_hz, damping) in zip(model.dynamics.axes, AXES, strict=True):
        assert axis.resonance_hz == pytest.approx(resonance_hz, rel=2e-3)
        assert axis.damping_ratio == pytest.approx(damping, rel=0.02)
    assert fit.judged[fit.kind].rms_um == pytest.approx((0.02, 0.02), rel=0.03)


def test_a_first_turn_without_an_inverse_does_not_end_the_fit(monkeypatch):
    """It has the axes begun with; the thresholds begun with were kept, with 1.4 times the error."""
    asked = []

    def lost(*_):
        asked.append(1)
        return len(asked) == 1

    monkeypatch.setattr(play_candidates, "lost_inverse", lost)
    given = Settings(operators=20, dynamics="second_order", sensor_bandwidth_hz=SENSOR_HZ)
    _, fit = identify(crowded(0.05, 1), given.changed(creep_modes=0, delay_samples=0))
    assert len(asked) > 1
    assert fit.judged[fit.kind].rms_um == pytest.approx((0.05, 0.05), rel=0.03)


def test_turns_that_gain_nothing_end_the_fit_of_thresholds_and_axes(monkeypatch):
    calls = []

    def nothing_gained(task, thresholds_v, dynamics, rounds):
        calls.append(rounds)
        return thresholds_v

    monkeypatch.setattr(play_candidates, "fitted_thresholds", nothing_gained)
    records = [Record(r.u_v[:1], r.y_um[:1], T) for r in campaign(0.01, frequencies=(30.0, 250.0))[:2]]
    given = Settings(
        partition="fitted",
        dynamics="second_order",
        operators=3,
        creep_modes=0,
        delay_samples=0,
        error_curve=False,
    )
    identify(records, given)
    assert len(calls) < play_candidates.MOST_TURNS
