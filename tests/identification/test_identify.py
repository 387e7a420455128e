"""From records to a model and a verdict: simulated records, and what must be said of them."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import theory
from record_cases import plain, plays

from hammerstein.dynamics import StateSpaceDynamics, StaticDynamics, discretise
from hammerstein.errors import IdentificationError, InputError
from hammerstein.hysteresis import Pair, PrandtlIshlinskii
from hammerstein.identification.fit_report import UNTOLD, verdict
from hammerstein.identification.identify import identify
from hammerstein.identification.score import Candidate, Score, invertibility_of
from hammerstein.identification.settings import Settings
from hammerstein.identification.state_space_candidates import (
    ModalCopies,
    behind_gain,
    fit_linear,
    fit_static_coupled,
)
from hammerstein.identification.static.initial_state import cautious_start, closed, judged_starts
from hammerstein.identification.static.regressors import InitialState
from hammerstein.model import HammersteinModel
from hammerstein.records.reading import read_records
from hammerstein.records.record import Record, run_in
from hammerstein.reporting.figures.identified import identified_figures, spectrum
from hammerstein.reporting.figures.write import svg_of
from hammerstein.reporting.fit_page import fit_json, fit_page

# Simulated: the published actuator through its drive and sensor ---------------------------------------------


def simulated(model, u, generator):
    """Voltages through drive, actuator and sensor, as the packaged actuator describes them."""
    instruments = model.instruments
    drive, _ = instruments.drive.apply(u)
    v, _ = model.hysteresis.respond(drive)
    block = discretise(model.dynamics, instruments.drive.sample_time_s, instruments.sensor.bandwidth_hz)
    y, _ = block.respond(v)
    reading = instruments.sensor.read(y[2:], generator)
    return Record(drive, reading, instruments.drive.sample_time_s), y[:2]


@pytest.fixture(scope="module")
def bimorph():
    """Sines of 10 V from 10 to 420 Hz and a multisine on each input, and an unseen record."""
    model, generator = HammersteinModel.load("duo_bimorph"), np.random.default_rng(0)
    t = model.instruments.drive.sample_time_s
    records = []
    for k in range(2):
        for f in (10.0, 100.0, 420.0):
            time_s = t * np.arange(round(max(0.05, 2.0 / f) / t))
            u = np.zeros((2, len(time_s)))
            u[k] = 10.0 * np.sin(2.0 * np.pi * f * time_s)
            records.append(simulated(model, u, generator)[0])
        time_s = t * np.arange(4000)
        tones = [
            np.sin(2.0 * np.pi * f * time_s + generator.uniform(0.0, 6.3)) for f in np.arange(5.0, 420.0, 5.0)
        ]
        u = np.zeros((2, len(time_s)))
        u[k] = 6.0 * np.sum(tones, axis=0) / np.abs(np.sum(tones, axis=0)).max()
        records.append(simulated(model, u, generator)[0])
    time_s = t * np.arange(4000)
    triangle = 8.0 * 2.0 / np.pi * np.arcsin(np.sin(2.0 * np.pi * 10.0 * time_s))
    lissajous = 8.0 * np.sin(2.0 * np.pi * np.array([[40.0], [30.0]]) * time_s)
    unseen = np.hstack([np.vstack([triangle, 0.0 * triangle]), lissajous])
    return model, records, simulated(model, unseen, generator)


@pytest.fixture(scope="module")
def bimorph_fit(bimorph):
    _, records, (held, _) = bimorph
    settings = plain(dynamics="second_order", sensor_bandwidth_hz=2000.0)
    return identify(records, settings, validation=[held])


def test_simulated_actuator_is_found_through_drive_and_sensor(bimorph, bimorph_fit):
    truth, _, (held, position_um) = bimorph
    model, fit = bimorph_fit
    for found, true in zip(model.dynamics.axes, truth.dynamics.axes, strict=True):
        assert found.resonance_hz == pytest.approx(true.resonance_hz, rel=0.003)
        assert found.damping_ratio == pytest.approx(true.damping_ratio, rel=0.03)
    v, _ = model.hysteresis.respond(held.u_v)
    said, _ = discretise(model.dynamics, held.sample_time_s).respond(v)
    error = said - position_um
    assert np.sqrt(np.mean(error**2, axis=1)).max() < 0.15
    assert fit.delay_samples == 0
    assert {start.kind for start in fit.starts} == {"rest", "stepped"}  # multisines begin with a jump
    assert fit.validation["hammerstein"].mean_percent < 0.1 * fit.validation["linear_dynamics"].mean_percent
    assert "The hysteresis block improves the model" in fit.verdict
    assert fit.invertible


def test_what_is_found_is_written_and_runs_again(bimorph_fit, tmp_path):
    model, fit = bimorph_fit
    model.save(tmp_path / "model.json")
    again = HammersteinModel.load(tmp_path / "model.json")
    assert again.to_json() == model.to_json()
    assert again.provenance["invertible"] is True
    assert again.hysteresis.pairs[0][0].weight_errors_um_per_v.min() > 0.0
    page = fit_page(model, fit, ["loops.svg"]).markdown()
    assert fit.verdict in page
    assert "](loops.svg)" in page
    assert "| **Hammerstein** |" in page
    assert "| linear gain |" in page
    plain = json.loads(fit_json(model, fit))
    assert set(plain["validation"]) == {"linear", "static_hysteresis", "linear_dynamics", "hammerstein"}
    assert len(plain["fit"]["hammerstein"]["nrmse_percent"]) == 2
    assert plain["axes"][0]["axis"]["resonance_hz"] == fit.axes[0].axis.resonance_hz


def test_figures_are_drawn_and_repeat_to_the_byte(bimorph_fit):
    figures = identified_figures(bimorph_fit[1])
    assert set(figures) == {"loops", "residual", "response"}
    labels = {axes.get_xlabel() for axes in figures["residual"].axes}
    assert {"time [ms]", "frequency [Hz]"} <= labels
    assert next(axes.get_ylabel() for axes in figures["loops"].axes) == "y1 [µm]"
    assert svg_of(figures["loops"]) == svg_of(identified_figures(bimorph_fit[1])["loops"])


# A model with dynamics that couple the outputs --------------------------------------------------------------


def coupled_truth():
    """Two resonances that each show at both outputs (eigenvalues of a rotated diagonal)."""
    radius, angle = 0.97, 0.2
    block = radius * np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    a = np.kron(np.diag([1.0, 0.8]), block)
    b = np.array([[0.05, 0.0], [0.02, 0.01], [0.0, 0.1], [0.05, 0.1]])
    c = np.array([[1.0, 0.2, 0.3, 0.0], [0.1, 0.0, 1.0, 0.4]])
    return a, b, c


def responses(a, b, c, v):
    x, y = np.zeros(len(a)), np.empty((len(c), v.shape[1]))
    for k in range(v.shape[1]):
        y[:, k] = c @ x
        x = a @ x + b @ v[:, k]
    return y


def test_coupled_dynamics_and_weights_are_told_apart():
    generator = np.random.default_rng(3)
    a, b, c = coupled_truth()
    r = np.array([0.0, 0.5, 1.5])
    w = np.array([[[2.0, 0.6, 0.3], [0.2, 0.1, 0.0]], [[0.0, 0.1, 0.2], [1.5, 0.3, 0.4]]])
    records = []
    for _ in range(4):
        one = generator.standard_normal((2, 1024))
        u = 4.0 * np.tile(one, 3) / np.abs(one).max()
        y = responses(a, b, c, theory.prandtl_ishlinskii(u, [[r] * 2] * 2, w))[:, 1024:]
        y = y + 1e-3 * generator.standard_normal(y.shape)
        records.append(Record(u[:, 1024:], y, 1e-3, period_samples=1024))
    settings = plain(thresholds_v=r, dynamics="state_space", order=4)
    _, fit = identify(records, settings)
    assert fit.fit["hammerstein"].mean_percent < 0.1 * fit.fit["linear_dynamics"].mean_percent
    assert "The hysteresis block improves the model" in fit.verdict

    _, found = identify(records, plain(thresholds_v=r, dynamics="state_space"))  # the order from the records
    assert found.order == 4 == len(a)
    assert found.fit["hammerstein"].mean_percent == pytest.approx(
        fit.fit["hammerstein"].mean_percent, rel=1e-6
    )
    assert "state space of order 2" in [trial.name for trial in found.trials]

    block, gain = fit_linear(records, 4)
    assert np.abs(block.response([0.1])[0].real - np.eye(2)).max() < 0.1  # unit gain, the rest is in the gain
    assert gain.shape == (2, 2)


def test_weights_behind_a_known_coupled_block_come_back():
    from hammerstein.dynamics import LinearBlock

    a, b, c = coupled_truth()
    r, w = np.array([0.0, 1.0]), np.array([[[2.0, 0.5], [0.3, 0.1]], [[0.2, 0.1], [1.5, 0.4]]])
    u = np.random.default_rng(4).uniform(-3.0, 3.0, (2, 2000))
    record = Record(u, responses(a, b, c, theory.prandtl_ishlinskii(u, [[r] * 2] * 2, w)), 1e-3)
    block = LinearBlock(a, b, c, np.zeros((2, 2)), 1e-3)
    for solver in ("least_squares", "invertible"):
        fit = fit_static_coupled([record], [[r] * 2] * 2, block, [InitialState("rest")], solver=solver)
        found = np.array([[pair.weights_um_per_v for pair in row] for row in fit.hysteresis.pairs])
        assert np.abs(found - w).max() < 1e-8
    falling = w.copy()
    falling[0, 0] = [-0.4, 2.4]  # whose first slope falls, and with it the determinant
    record = Record(u, responses(a, b, c, theory.prandtl_ishlinskii(u, [[r] * 2] * 2, falling)), 1e-3)
    for solver, comes_back in (("least_squares", True), ("invertible", False)):
        fit = fit_static_coupled([record], [[r] * 2] * 2, block, [InitialState("rest")], solver=solver)
        found = np.array([[pair.weights_um_per_v for pair in row] for row in fit.hysteresis.pairs])
        assert (np.abs(found - falling).max() < 1e-8) == comes_back
        assert (found[0, 0, 0] > 0.0) != comes_back
    path = ModalCopies.of(block, 1, 0)
    said, _ = path.respond(u[:1], path.settled(np.zeros(1)))
    assert np.abs(said - responses(a, b[:, :1], c[1:], u[:1])).max() < 1e-9
    split = behind_gain(block, np.array([[2.0, 0.0], [0.0, 4.0]]))
    assert np.abs(split.response([5.0]) * [2.0, 4.0] - block.response([5.0])).max() < 1e-12


# What must be said ------------------------------------------------------------------------------------------


def sine_record(lag=0.0, samples=1200, noise=0.0):
    u = 10.0 * np.sin(2.0 * np.pi * np.arange(samples) / 400)[None]
    v = theory.prandtl_ishlinskii(u, [[theory.R_V]], [[theory.W_XX]])
    y = np.empty_like(v)
    state = v[0, 0]
    for k, value in enumerate(v[0]):
        state = lag * state + (1.0 - lag) * value
        y[0, k] = state
    return Record(u, y + noise * np.random.default_rng(0).standard_normal(y.shape), 5e-5)


def test_a_lagging_loop_never_gives_a_model_without_inverse_silently():
    record = sine_record(lag=0.96)
    model, fit = identify([record], plain(delay_samples=0))
    assert fit.invertible
    assert min(model.hysteresis.pairs[0][0].slopes) > 0.0
    assert "held at the lower bound" in fit.notes[0]
    assert "phase lag" not in fit.notes[0]  # one rate cannot tell it from hysteresis
    free, said = identify([record], plain(delay_samples=0, solver="least_squares"))
    lowest = min(free.hysteresis.pairs[0][0].slopes)
    assert lowest < 0.0
    assert f"would be {lowest:.3g} um/V" in fit.notes[0]
    assert not said.invertible
    assert "no inverse" in said.invertibility
    assert free.provenance["invertible"] is False
    assert "This model has no inverse" in fit_page(free, said).markdown()


def test_a_butterfly_is_flagged():
    u = 10.0 * np.sin(2.0 * np.pi * np.arange(1200) / 400)
    play = theory.play(u, 1.0)
    _, fit = identify([Record([u], [0.1 * play**2], 5e-5)], plain(delay_samples=0))
    assert any("no rising loop" in flag for flag in fit.flags)
    assert any(flag.startswith("the error of") for flag in fit.flags)


def test_verdict_speaks_of_what_it_compares():
    scores = {
        "linear": Score((8.0,), (1.0,), (30.0,)),
        "static_hysteresis": Score((7.9,), (1.0,), (29.0,)),
        "linear_dynamics": Score((0.7,), (0.1,), (3.0,)),
        "hammerstein": Score((0.69,), (0.1,), (2.9,)),
    }
    said = verdict(scores, False, ("y saturates",))
    assert said.startswith("On the fitted records (no validation record): linear gain 8 %")
    assert (
        "The hysteresis block does not improve the model: the error is 0.7 % without and 0.69 % with it."
        in said
    )
    assert "The linear dynamics improve the model: they lower the error from 7.9 to 0.69 %." in said
    assert said.endswith("cannot represent these records: y saturates.")
    asked = {
        kept: verdict(scores, True, (), "second_order", kept) for kept in ("static_hysteresis", "hammerstein")
    }
    assert asked["static_hysteresis"] == f"{UNTOLD} {verdict(scores, True, (), 'auto', 'static_hysteresis')}"
    assert asked["hammerstein"] == verdict(scores, True, (), "auto", "hammerstein")
    assert "linear dynamics improve" not in asked["static_hysteresis"]  # beside "this model is static"


@pytest.mark.parametrize(("plays", "improve"), [(0.4, True), (0.84, False)])
def test_dynamics_behind_another_hysteresis_are_not_judged_by_plays_that_were_fitted_roughly(plays, improve):
    """They "did not improve the model" where they took its error from 0.76 to 0.17 %."""
    scores = {
        "linear": Score((2.4,), (1.0,), (30.0,)),
        "static_hysteresis": Score((0.72,), (0.3,), (9.0,)),
        "classical": Score((plays,), (0.4,), (10.0,)),
        "hammerstein": Score((0.17,), (0.1,), (2.9,)),
    }
    said = verdict(scores, True, ())
    assert ("The linear dynamics improve the model" in said) == improve
    assert "dynamics do not improve" not in said
    assert (
        f"Hysteresis beyond plays improves the model: it lowers the error from {plays:g} to 0.17 %." in said
    )


def test_a_linear_block_without_inverse_is_blamed_with_its_frequency():
    z = np.exp(2j * np.pi * 100.0 * 1e-3)  # a zero on the unit circle at 100 Hz
    c = [[-2.0 * z.real, 1.0]]
    blocked = StateSpaceDynamics(
        A=((0.0, 0.0), (1.0, 0.0)), B=((1.0,), (0.0,)), C=(tuple(c[0]),), D=((1.0,),), sample_time_s=1e-3
    )
    model = identify([sine_record()], plain())[0]
    ok, sentence = invertibility_of(model.hysteresis, blocked, 10.0, 1e-3, ("u1", "u2"))
    assert not ok
    assert "no usable inverse at 100 Hz" in sentence


def test_starts_are_told_from_the_records():
    u = 10.0 * np.sin(2.0 * np.pi * np.arange(1600) / 400)
    rest = Record([u], theory.prandtl_ishlinskii([u], [[theory.R_V]], [[theory.W_XX]]), 5e-5)
    assert identify([rest], plain())[1].starts == (InitialState("rest"),)
    moving = Record([u[400:]], rest.y_um[:, 400:], 5e-5)
    _, fit = identify([moving], plain(thresholds_v=theory.R_V))
    assert fit.starts[0].kind == "turned"
    assert fit.starts[0].turn_v[0][1] == pytest.approx(-10.0)  # there the sine turned before it went on
    assert fit.fit["static_hysteresis"].rms_um[0] < 1e-9
    known = identify([moving], plain(start="repeated"))[1].starts
    assert known == (InitialState("repeated", run_in(moving)),)
    loop = Record([u[500:901]], rest.y_um[:, 500:901], 5e-5)
    assert closed(loop)
    assert cautious_start(loop) == InitialState("repeated")
    assert identify([moving], plain(start="rest"))[1].starts == (InitialState("rest"),)


def test_a_beginning_that_a_simpler_model_explains_is_not_left_out():
    t = np.arange(2000) / 400
    u = 5.0 - 5.0 * np.cos(2.0 * np.pi * t) * np.linspace(1.0, 0.5, 2000)
    plays = (([0.0, 2.0, 6.0], [3.0, 1.0, 0.5]), ([0.0, 2.0], [3.0, 1.0]), ([0.0], [3.7]))
    truth = [PrandtlIshlinskii([[Pair(r, w)]]) for r, w in plays]
    right, late, linear = (Candidate(block, StaticDynamics(n_outputs=1)).predict for block in truth)
    record = Record([u], truth[0].respond([u])[0], 1e-3)  # its play of 6 V moves in the first rise alone
    (start,) = judged_starts([record], late, 0.0)
    assert start.kind == "repeated"
    assert start.first > 0
    assert judged_starts([record], late, 0.0, simpler=[linear]) == (start,)
    assert judged_starts([record], late, 0.0, simpler=[linear, right]) == (InitialState("rest"),)


def test_a_dead_start_is_used_as_it_is():
    record = sine_record(noise=0.01)
    still = np.zeros((1, 60))
    late = Record(np.hstack([still, record.u_v]), np.hstack([still + 3.0, record.y_um + 3.0]), 5e-5)
    model, fit = identify([late], plain(thresholds_v=theory.R_V, delay_samples=0))
    assert fit.starts == (InitialState("rest"),)
    assert fit.offsets_um[0][0] == pytest.approx(3.0, abs=0.01)
    assert model.hysteresis.pairs[0][0].slopes == pytest.approx(np.cumsum(theory.W_XX), abs=0.3)


def test_identification_is_pure():
    record = sine_record(noise=0.05)
    first, again = (identify([record], plain(operators=6)) for _ in range(2))
    assert first[0].to_json() == again[0].to_json()
    assert fit_json(*first) == fit_json(*again)


def test_progress_is_told():
    told = []
    identify([sine_record()], plain(), progress=told.append)
    assert "estimating the delay" in told
    assert "fitting the static block" in told


# Refusals ---------------------------------------------------------------------------------------------------


def test_settings_name_every_mistake_at_once():
    with pytest.raises(InputError) as caught:
        plain(
            operators=0, solver="best", dynamics="none", order=4, creep_modes=2, ridge=-1.0, delay_samples=-1
        )
    wheres = [mistake.where for mistake in caught.value.mistakes]
    assert sorted(wheres) == ["delay_samples", "operators", "ridge", "solver"]
    with pytest.raises(InputError) as caught:
        plain(solver="closed_form", dynamics="none", order=4, creep_modes=2, ridge=1.0)
    assert [mistake.where for mistake in caught.value.mistakes] == ["order", "creep_modes", "ridge"]
    with pytest.raises(InputError, match="closed_form ignores dynamics"):
        plain(solver="closed_form", dynamics="second_order")
    with pytest.raises(InputError, match="must be a whole number or a list or 'auto', not 'some'"):
        plain(operators="some")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("operators", 2.5), ("operators", True), ("creep_modes", "yes"), ("creep_modes", 1.5)),
        *(("delay_samples", value) for value in (1.5, True, math.inf, math.nan)),
    ],
)
def test_numbers_of_things_are_whole(name, value):
    with pytest.raises(InputError, match=r"whole number|finite number") as caught:
        Settings(**{name: value})
    assert [mistake.where for mistake in caught.value.mistakes] == [name]


def test_the_whole_numbers_of_numpy_are_whole():
    assert Settings(operators=np.int64(3), creep_modes=np.int32(1), delay_samples=2.0) == Settings(
        operators=3, creep_modes=1, delay_samples=2
    )


def test_one_record_is_taken_for_a_list_of_one_and_anything_else_is_named():
    record = sine_record()
    known = plain(delay_samples=0)
    model, fit = identify(record, known, validation=record)
    again, _ = identify((one for one in [record]), known)
    assert model.hysteresis == again.hysteresis
    assert fit.held
    with pytest.raises(InputError, match="records: hold a tuple; give values of Record"):
        identify([(record.u_v, record.y_um)], known)
    with pytest.raises(InputError, match=r"settings: are a dict; give Settings"):
        identify([record], {"operators": 3})


def test_numbers_and_thresholds_must_fit_the_axes():
    record = sine_record()
    with pytest.raises(InputError, match=r"have shape \(1, 2\)"):
        identify([record], plain(operators=[[3, 4]]))
    with pytest.raises(InputError, match="1 rows of 1 arrays"):
        identify([record], plain(thresholds_v=[[[0.0], [1.0]]]))
    with pytest.raises(IdentificationError, match="never engaged"):
        identify([record], plain(thresholds_v=[0.0, 11.0]))
    assert identify([record], plain(operators=[[3]]))[1].operators == ((3,),)


def test_records_that_do_not_belong_together_are_refused():
    record = sine_record()
    two = Record(np.vstack([record.u_v, record.u_v[:, ::-1]]), record.y_um, 5e-5)
    with pytest.raises(InputError, match="have different axes: 1 inputs and 1 outputs, 2 inputs"):
        identify([record, two])
    with pytest.raises(InputError, match="there are none"):
        identify([])
    with pytest.raises(InputError, match="swapped"):
        identify([Record(record.y_um[:, 100:], record.u_v[:, 100:], 5e-5)])


def test_a_record_that_is_given_twice_is_refused_by_whatever_name():
    u = 5.0 * np.sin(np.linspace(0.0, 20.0, 400))
    one = Record([u], [3.0 * u], 1e-3, source="a.csv")
    copy = Record([u], [3.0 * u], 1e-3, source="b.csv")
    other = Record([u], [3.0 * u + 0.01 * u**2], 1e-3, source="c.csv")
    for given, said in (
        ([one, one], "a.csv: is given twice"),
        ([one, copy], "b.csv: is the same record as a.csv"),
    ):
        with pytest.raises(InputError, match=said):
            identify(given, plain(operators=1))
        with pytest.raises(InputError, match=said):
            identify([other], plain(operators=1), validation=given)
    identify([one, other], plain(operators=1))


def test_inputs_driven_together_are_not_taken_for_swapped_columns():
    phase = 2.0 * np.pi * np.arange(2400) / 400
    u = np.array([10.0 * np.sin(phase), 5.0 * np.sin(phase - 0.4) + 2.0 * np.sin(3.0 * phase)])
    y = np.array([[1.0, 0.0]]) @ u  # leads the second input for no other reason than the first
    _, fit = identify([Record(u, y, 5e-5)], plain(operators=3, delay_samples=0))
    assert fit.fit["linear"].rms_um[0] < 1e-6
    with pytest.raises(InputError, match="swapped"):
        identify([Record(u[1:], y, 5e-5)], plain(operators=3))


def test_files_are_identified_with_the_columns_they_name(tmp_path):
    record = sine_record(noise=0.02)
    table = np.column_stack([record.u_v[0], 1e3 * record.y_um[0]])
    np.savetxt(tmp_path / "record.csv", table, delimiter=",", header="volt,nm", comments="")
    options = {"inputs": ["volt"], "outputs": ["nm"], "rate_hz": 20_000.0, "output_scale": 1e-3}
    records = read_records([tmp_path / "record.csv"], **options)
    model, fit = identify(records, plain(), name="bench")
    assert model.name == "bench"
    assert (model.inputs, model.outputs) == (("volt",), ("um",))  # the unit of its numbers now
    assert fit.fit["static_hysteresis"].rms_um[0] == pytest.approx(0.02, rel=0.5)


def test_spectrum_keeps_the_peaks():
    time_s = 1e-3 * np.arange(4000)
    error = 2.0 * np.sin(2.0 * np.pi * 60.0 * time_s) + 0.01 * np.sin(2.0 * np.pi * 200.0 * time_s)
    frequency_hz, amplitude = spectrum(error, 1e-3)
    assert amplitude.max() == pytest.approx(2.0, rel=1e-3)
    assert amplitude[np.argmin(np.abs(frequency_hz - 200.0))] == pytest.approx(0.01, rel=0.02)


def test_the_closed_form_of_late_readings_is_that_of_prompt_ones():
    delay = 3
    u = 10.0 * np.sin(2.0 * np.pi * np.arange(900) / 200)
    y = plays(u, [0.0, 1.0, 4.0]).T @ [3.0, 1.0, 0.7]
    late = Record(u[None, delay:], y[None, :-delay], 1e-3)
    prompt = Record(u[None, delay:-delay], y[None, delay:-delay], 1e-3)
    asked = {"solver": "closed_form", "operators": 6}
    found, expected = (
        identify([one], plain(delay_samples=d, **asked))[0].hysteresis
        for one, d in ((late, delay), (prompt, 0))
    )
    np.testing.assert_allclose(found.weights[0], expected.weights[0], rtol=1e-9)
    assert found.weights[0].sum() > 3.0


def test_closed_form_takes_thresholds_uniform_in_voltage():
    u = 10.0 * np.sin(2.0 * np.pi * np.arange(1600) / 800)
    y = theory.prandtl_ishlinskii([u], [[[0.0, 2.5, 5.0, 7.5]]], [[[3.0, 1.0, 0.5, 0.5]]])
    record = Record([u], y, 1e-3)
    settings = plain(solver="closed_form", partition="voltage", operators=4)
    model, _ = identify([record], settings)
    pair = model.hysteresis.pairs[0][0]
    np.testing.assert_allclose(pair.thresholds_v, [0.0, 2.5, 5.0, 7.5])
    np.testing.assert_allclose(pair.weights_um_per_v, [3.0, 1.0, 0.5, 0.5], rtol=0.02)


def test_phase_lag_is_suspected_only_where_the_loop_was_seen_to_widen():
    """A lag of 8 ms alone: the width is the sine of its phase, 6.3 % at 1.25 Hz and 59 % at 12.5 Hz."""
    n = np.arange(4000)
    records = [
        Record([np.sin(2.0 * np.pi * n / period)], [4.0 * np.sin(2.0 * np.pi * (n - 8) / period)], 1e-3)
        for period in (800, 80)
    ]
    known = plain(operators=8, delay_samples=0, start="repeated")
    fast, both = (" ".join(identify(some, known)[1].notes) for some in (records[1:], records))
    assert "held at the lower bound" in fast
    assert "phase lag" not in fast
    slow, quick = (100.0 * np.sin(2.0 * np.pi * 8 / period) for period in (800, 80))
    assert (
        f"its loop is {slow:.2g} % wide at 1.25 Hz and {quick:.2g} % at 12.5 Hz: phase lag looks like" in both
    )


def test_the_response_of_a_model_is_estimated_as_that_of_the_records(bimorph_fit):
    """A window smears both alike: where inputs explain the output, a good model lies on what was measured."""
    panels = identified_figures(bimorph_fit[1])["response"].axes
    apart = []
    for place in (0, 4):  # the direct pairs of two axes, each row with its coherence behind them
        measured, model = (line.get_ydata() for line in panels[place].lines)
        (hz, *_) = (line.get_xdata() for line in panels[place].lines)
        (coherence,) = (line for line in panels[place // 3 * 3 + 2].lines)
        sure = np.interp(hz, coherence.get_xdata(), coherence.get_ydata()) > 0.8
        assert sure.sum() > 5
        apart.append(np.abs(model / measured - 1.0)[sure].max())
    assert max(apart) < 0.02


@pytest.mark.parametrize(
    "given", [-1.0, 5.0, "a", [["x"]], [[0.0, 1.0], 2.0], [1.0, 0.5], [[[0.0, 1.0], [2.0, 1.0]]]]
)
def test_thresholds_that_are_none_are_refused(given):
    with pytest.raises(InputError, match=r"each larger than the previous one|is not a list of voltages"):
        Settings(thresholds_v=given)
