import json
import math
from dataclasses import replace

import control
import numpy as np
import pytest
import theory as table
import theory_linear as theory
from threadpoolctl import threadpool_info, threadpool_limits

from hammerstein.blocks.instruments import Drive, Instruments, Sensor, standard_noise
from hammerstein.blocks.voltages import Voltages
from hammerstein.errors import InputError, SimulationError
from hammerstein.experiment.measure import _sensor_lag, rows_of
from hammerstein.experiment.run import run, simulate, simulate_in_blocks
from hammerstein.experiment.set_up import set_up
from hammerstein.hysteresis import Pair, PrandtlIshlinskii
from hammerstein.metrics import Row
from hammerstein.model import HammersteinModel
from hammerstein.model.simulation import BLOCK, Plant
from hammerstein.runtime.resources import one_blas_thread
from hammerstein.scenario import Scenario, load_scenario
from hammerstein.scenario.scenario import Measure


def _scenario(**tables):
    base = {"question": "?", "actuator": "duo_bimorph"}
    return Scenario.model_validate(base | tables)


def _rows(report, **key):
    return [row for row in report.rows if all(getattr(row, k) == v for k, v in key.items())]


LOOP = {"kind": "sine", "amplitude_v": 10, "frequency_hz": 50}
PAPER = {"label": "paper", "law": "inverse_multiplicative", "identification": {"frequency_hz": 50}}


@pytest.mark.parametrize("actuator", ["duo_bimorph", "duo_bimorph_resonant"])
def test_measured_loops_are_the_published_ones(actuator):
    report = run(_scenario(actuator=actuator, drive=LOOP, measure={"measured_cycles": 20}))
    height = {(r.measured_axis, r.excited_axis): r.height_um / 2 for r in report.rows}
    width = {(r.measured_axis, r.excited_axis): r.width_percent for r in report.rows}
    published = {("x", "x"): 58.4, ("y", "y"): 50.6, ("x", "y"): 1.41, ("y", "x"): 2.08}
    for pair, wanted in published.items():
        assert height[pair] == pytest.approx(wanted, rel=0.02)
    assert width["x", "x"] == pytest.approx(16.7, rel=0.02)
    assert width["y", "y"] == pytest.approx(15.2, rel=0.02)


def test_static_actuator_on_an_ideal_bench_has_the_closed_form_loop():
    table = HammersteinModel.load("duo_bimorph_static")
    time_s = np.arange(1200) * 50e-6
    u = np.zeros((2, 1200))
    u[0] = 10.0 * np.sin(2 * np.pi * 50.0 * time_s)
    response = Plant(table, Instruments.ideal()).respond(u, [1])
    pair = table.hysteresis.pairs[0][0]
    x, voltage = response.position_um[0, 400:], u[0, 400:]
    amplitude = sum(w * (10.0 - r) for w, r in zip(pair.weights_um_per_v, pair.thresholds_v, strict=True))
    assert amplitude == pytest.approx(58.39759, abs=1e-9)
    assert x.max() == pytest.approx(amplitude, abs=1e-9)
    assert x.min() == pytest.approx(-amplitude, abs=1e-9)
    rising = np.diff(voltage, prepend=voltage[0]) > 0
    branch = [
        np.sum(pair.weights_um_per_v * np.maximum(0.0, v + 10.0 - 2 * pair.thresholds_v)) for v in voltage
    ]
    np.testing.assert_allclose(x[rising], np.array(branch)[rising] - amplitude, atol=1e-9)


@pytest.mark.parametrize("frequency_hz", [150.0, 250.0, 400.0])
def test_without_hysteresis_the_rms_error_is_that_of_the_linear_block(frequency_hz, tmp_path):
    # A unit gain behind the dynamics, on a fine grid, without instruments.
    model = HammersteinModel(
        name="linear",
        hysteresis=PrandtlIshlinskii(((Pair.linear(5.0),),)),
        dynamics=HammersteinModel.load("duo_bimorph").dynamics.model_copy(
            update={"axes": HammersteinModel.load("duo_bimorph").dynamics.axes[:1]}
        ),
        amplitude_v=10.0,
        inputs=("u",),
        outputs=("x",),
        instruments=Instruments.ideal(5e-8),
    )
    model.save(tmp_path / "linear.json")
    reference = {"kind": "sine", "amplitude_um": 20, "frequency_hz": frequency_hz}
    unit = {"label": "none", "law": "none", "model": str(tmp_path / "linear.json")}
    scenario = _scenario(
        actuator=str(tmp_path / "linear.json"),
        reference=reference,
        compensators=[unit],
        measure={"settle_s": 0.08, "measured_cycles": 1},
    )
    (row,) = run(scenario).rows
    axis = model.dynamics.axes[0]
    gain = theory.second_order(frequency_hz, axis.resonance_hz, axis.damping_ratio)
    assert row.rms_true_um == pytest.approx(theory.rms_of_sine_error(gain, 20.0), rel=1e-4)


def test_chain_equals_python_controls_interconnect():
    plant = Plant(HammersteinModel.load("duo_bimorph"), Instruments.ideal())
    u = 8.0 * np.random.default_rng(0).normal(size=(2, 60))
    ours = plant.respond(u, [1])
    hysteresis = plant.model.hysteresis.to_iosys(50e-6)
    block = control.c2d(plant.model.dynamics.system(), 50e-6, "zoh")
    linear = control.ss(block, name="linear", inputs=hysteresis.output_labels, outputs=["x", "y"])
    loop = control.interconnect([hysteresis, linear], inputs=hysteresis.input_labels, outputs=["x", "y"])
    theirs = control.input_output_response(loop, np.arange(60) * 50e-6, u)
    np.testing.assert_allclose(ours.position_um, theirs.outputs, atol=1e-9)


def test_rows_depend_neither_on_jobs_nor_on_the_run():
    scenario = _scenario(
        reference={"kind": "sine", "amplitude_um": 20, "frequency_hz": 50},
        sweep={"frequency_hz": [50, 150]},
        compensators=[PAPER],
    )
    texts = {run(scenario, "same", jobs=jobs).to_json() for jobs in (1, 2, 1)}
    assert len(texts) == 1


def threads():
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


def test_a_run_has_linear_algebra_on_one_thread_and_leaves_the_caller_s():
    """Sums of several threads end in other last bits; the command line's environment asks for one anyway."""

    seen = []
    with threadpool_limits(2, "blas"):
        before = threads()
        run(_scenario(drive=LOOP), "x", progress=lambda *told: seen.append(threads()))
        assert threads() == before
    assert seen
    assert set().union(*seen) <= {1}


def test_whoever_leaves_last_puts_the_threads_of_linear_algebra_back():
    with threadpool_limits(2, "blas"):
        before = threads()
        first, second = one_blas_thread(), one_blas_thread()
        first.__enter__()
        second.__enter__()
        first.__exit__(None, None, None)
        assert threads() <= {1}
        second.__exit__(None, None, None)
        assert threads() == before


def test_seed_changes_the_noise_and_not_the_position():
    a, b = (run(_scenario(drive=LOOP, seed=seed), "x") for seed in (1, 2))
    assert a.to_json() != b.to_json()
    first, second = (simulate(_scenario(drive=LOOP, seed=seed)) for seed in (1, 2))
    np.testing.assert_array_equal(first.position_um, second.position_um)
    assert (first.reading_um != second.reading_um).any()


TRACK = {"kind": "sine", "amplitude_um": 20, "frequency_hz": 50}


def _numbers(scenario, model=None):
    if model is not None:
        setup = set_up(scenario, model=model)
        return [list(rows_of(setup, case).rows[i].figures.values()) for case in setup.cases() for i in (0, 1)]
    return [list(row.figures.values()) for row in run(scenario, "x").rows]


def test_no_name_moves_a_number():
    """The noise follows from the seed and the position of the experiment, not from what things are called."""
    two = [PAPER, {"label": "none", "law": "none", "identification": {"frequency_hz": 20}}]
    renamed = [{**one, "label": f"{one['label']} again"} for one in two]
    before, after = (_scenario(reference=TRACK, compensators=laws) for laws in (two, renamed))
    assert _numbers(before) == _numbers(after)
    model = HammersteinModel.load("duo_bimorph")
    called = replace(model, name="another", inputs=("U1", "U2"), outputs=("left", "right"))
    assert _numbers(before, model) == _numbers(before, called)
    said = {**TRACK, "phase_deg": 0.0, "offset_um": 0.0}  # the same signal in other words
    assert _numbers(_scenario(reference=said, compensators=two)) == _numbers(before)


def test_a_signal_file_moves_no_number_by_its_name(tmp_path):
    volts = 8.0 * np.sin(2 * np.pi * 50.0 * np.arange(800) * 50e-6)
    text = "time_s,x,y\n" + "".join(f"{50e-6 * k!r},{v!r},0\n" for k, v in enumerate(volts.tolist()))
    found = []
    for name in ("first.csv", "second.csv"):
        (tmp_path / name).write_text(text)
        found.append(_numbers(_scenario(drive={"kind": "file", "path": str(tmp_path / name)})))
    assert found[0] == found[1]


def test_what_comes_later_in_a_scenario_moves_no_number_before_it():
    more = [PAPER, {"label": "none", "law": "none", "identification": {"frequency_hz": 20}}]
    few, many = (_scenario(reference=TRACK, compensators=laws) for laws in (more[:1], more))
    assert _numbers(many)[:2] == _numbers(few)[:2]
    swept = _scenario(reference=TRACK, compensators=more, sweep={"frequency_hz": [50, 70]})
    assert _numbers(swept)[: len(_numbers(many))] == _numbers(many)


def test_every_case_has_its_own_noise_and_all_trials_of_one_the_same():
    cases = list(
        set_up(_scenario(reference=TRACK, compensators=[PAPER], sweep={"frequency_hz": [50, 70]})).cases()
    )
    assert len({tuple(case.seed(1)) for case in cases}) == len(cases) == 4
    (learned,) = {tuple(replace(cases[0], trial=trial).seed(1)) for trial in (1, 2, None)}
    assert learned == tuple(cases[0].seed(1))


def test_one_case_of_a_sweep_is_the_case_of_the_run():
    scenario = _scenario(drive=LOOP, sweep={"frequency_hz": [20, 50]})
    alone = simulate(scenario, frequency_hz=50.0)
    trace = run(scenario, "x").traces[2]
    np.testing.assert_array_equal(alone.reading_um[:, trace.first_sample :], trace.response.reading_um)


def test_compensator_takes_the_hysteresis_and_the_coupling_out():
    reference = {"kind": "sine", "amplitude_um": 50, "frequency_hz": 20}
    none = {"label": "none", "law": "none", "identification": {}}
    single = {"label": "decoupled", "law": "decoupled_inverse", "identification": {}}
    report = run(_scenario(reference=reference, compensators=[none, PAPER, single]))

    def rms(label, measured, excited):
        (row,) = _rows(report, compensator=label, measured_axis=measured, excited_axis=excited)
        return row.rms_um

    assert rms("paper", "x", "x") < 0.3 * rms("none", "x", "x")
    assert rms("paper", "y", "x") < 0.6 * rms("decoupled", "y", "x")
    assert rms("decoupled", "y", "x") > 1.0


def test_model_error_is_small_up_to_its_frequency_and_grows_above():
    models = [{"label": "50", "identification": {"frequency_hz": 50}}]
    report = run(_scenario(drive=LOOP, sweep={"frequency_hz": [10, 50, 100, 200]}, models=models))
    rms = [row.rms_um for row in _rows(report, excited_axis="x", measured_axis="x")]
    assert rms[1] < 0.5
    assert rms[0] < 3.0
    assert rms[1] < rms[2] < rms[3]
    assert rms[3] > 10 * rms[0]


@pytest.mark.parametrize(
    ("tables", "kind", "message"),
    [
        ({"drive": LOOP | {"frequency_hz": 12000}}, InputError, "half the sample rate"),
        ({"drive": LOOP | {"axis": 3}}, InputError, "does not exist"),
        ({"drive": LOOP, "actuator": "duo_bimorf"}, InputError, "duo_bimorph"),
        (
            {"reference": {"kind": "circle", "radius_um": 80, "frequency_hz": 50}, "compensators": [PAPER]},
            SimulationError,
            "needs 80 um on x, but the actuator reaches",
        ),
        (
            {
                "reference": {"kind": "circle", "radius_um": 20, "frequency_hz": 50},
                "compensators": [PAPER | {"gain": "identity"}],
            },
            SimulationError,
            "does not converge.*slopes.*spectral radius.*auto",
        ),
    ],
)
def test_what_cannot_be_run_says_why(tables, kind, message):
    with pytest.raises(kind, match=message):
        run(_scenario(**tables))


def test_the_paper_as_printed_diverges_when_told_to_run():
    printed = PAPER | {"gain": "identity", "run_anyway": True}
    reference = {"kind": "circle", "radius_um": 20, "frequency_hz": 50}
    ideal = {"drive": {"range_v": math.inf}}
    with pytest.raises(SimulationError, match="grows beyond"):
        run(_scenario(reference=reference, compensators=[printed], instruments=ideal))


def test_saturation_is_counted_and_told():
    reference = {"kind": "sine", "amplitude_um": 51.2, "frequency_hz": 20, "axis": 2}
    report = run(
        _scenario(reference=reference, compensators=[{"label": "none", "law": "none", "identification": {}}])
    )
    assert all(row.saturated_samples > 0 for row in report.rows)
    assert any("clipped" in statement for statement in report.statements)


def test_report_is_plain_json_with_the_scenario_inside():
    content = json.loads(run(_scenario(drive=LOOP), "loops").to_json())
    assert content["scenario"]["drive"]["amplitude_v"] == 10
    assert Scenario.model_validate(content["scenario"]).digest() == content["scenario_digest"]


def test_shipped_scenarios_are_valid():
    from pathlib import Path

    files = sorted((Path(__file__).parents[2] / "scenarios").glob("*.toml"))
    assert len(files) >= 10
    assert len({load_scenario(file).digest() for file in files}) == len(files)


def test_the_lag_of_the_sensor_is_told_from_the_error_of_the_actuator():
    content = {
        "question": "?",
        "actuator": "duo_bimorph",
        "reference": {"kind": "sine", "amplitude_um": 20.0, "frequency_hz": 100.0, "axis": 1},
        "compensators": [{"label": "inverse", "law": "hammerstein_inverse", "model": "duo_bimorph"}],
    }
    said = run(Scenario.model_validate(content)).statements
    lag = 20.0 / np.sqrt(2.0) * 100.0 / 2000.0  # first order, small angle
    (text,) = [text for text in said if text.startswith("The sensor of 2000 Hz lags")]
    assert float(text.split("rms error on x is ")[1].split()[0]) == pytest.approx(lag, rel=0.05)
    prompt = {**content, "instruments": {"sensor": {"bandwidth_hz": float("inf")}}}
    assert not [t for t in run(Scenario.model_validate(prompt)).statements if "lags" in t]


def test_a_clipped_loop_is_as_high_as_the_sensor_reads():
    """Its edges have harmonics without end: without those above the bandwidth it was 61.5 um of 60."""
    content = {
        "drive": {"kind": "sine", "amplitude_v": 8.0, "frequency_hz": 50.0, "axis": 1},
        "instruments": {
            "sensor": {"range_um": 30.0, "noise_um": 0.0, "resolution_um": 0.0, "bandwidth_hz": 500.0}
        },
    }
    report = run(_scenario(actuator="duo_bimorph", **content))
    (row,) = [row for row in report.rows if row.measured_axis == "x"]
    assert row.height_um == pytest.approx(60.0, rel=1e-9)


@pytest.mark.parametrize(("reading", "told"), [(1.9, False), (2.1, True), (15.0, True)])
def test_a_sensor_lags_where_the_reading_is_off_twice_as_far_as_the_position(reading, told):
    """However far the position is off."""
    content = {
        "reference": {"kind": "sine", "amplitude_um": 20.0, "frequency_hz": 100.0, "axis": 1},
        "compensators": [{"label": "inverse", "law": "exact_inverse", "model": "duo_bimorph"}],
    }
    here = set_up(_scenario(actuator="duo_bimorph", **content))
    for true in (0.1, 1.0, 40.0):
        row = Row("inverse", "x", "x", 100.0, figures={"rms_um": reading * true, "rms_true_um": true})
        assert bool(_sensor_lag(here, [row])) == told


def test_a_slow_sensor_is_noisy_and_does_not_lag():
    """At 1 Hz a sensor of 2000 Hz lags by 0.01 um, and its noise is 0.04 um."""
    sine = {"kind": "sine", "amplitude_um": 20.0, "frequency_hz": 1.0, "axis": 1}
    law = {"label": "inverse", "law": "exact_inverse", "model": "duo_bimorph"}
    asked = _scenario(actuator="duo_bimorph", reference=sine, compensators=[law])
    row = Row("inverse", "x", "x", 1.0, figures={"rms_um": 0.042, "rms_true_um": 0.002})
    (text,) = _sensor_lag(set_up(asked), [row])
    assert text.startswith("The sensor is noisy: ")


LONG = {"measure": {"settle_cycles": 3, "measured_cycles": 4}}
PATH = {"kind": "lissajous", "amplitude_um": 20.0, "frequency_x_hz": 60.0, "frequency_y_hz": 40.0}


@pytest.mark.parametrize(
    "content",
    [
        {"drive": {"kind": "triangle", "amplitude_v": 10.0, "frequency_hz": 70.0}},
        {"drive": {"kind": "multisine", "amplitude_v": 10.0, "lowest_hz": 10.0, "highest_hz": 300.0}},
        *(
            {
                "reference": PATH | {"smooth_start_s": 0.01},
                "compensators": [{"label": law, "law": law, "model": "duo_bimorph"}],
            }
            for law in ("none", "inverse_multiplicative", "decoupled_inverse", "exact_inverse")
        ),
    ],
)
@pytest.mark.parametrize("samples", [777, *(pytest.param(n, marks=pytest.mark.full) for n in (1, 10_000))])
def test_a_run_in_blocks_is_the_run_in_one_piece(content, samples):
    scenario = _scenario(actuator="duo_bimorph_creep", **LONG, **content)
    if samples == 1:
        scenario = scenario.model_copy(
            update={"measure": Measure(settle_cycles=0, settle_s=0.0, measured_cycles=1)}
        )
    whole = simulate(scenario)
    parts = list(simulate_in_blocks(scenario, samples))
    for name in ("requested_v", "drive_v", "hysteresis_um", "position_um", "reading_um", "saturated"):
        joined = np.concatenate([getattr(part, name) for part in parts], axis=1)
        assert (joined == getattr(whole, name)).all(), name
    assert (parts[0].reference_um is None) == (scenario.reference is None)


def test_an_input_that_has_left_its_range_end_has_left_it_in_later_blocks_too():
    """It rests at 0 V, the low end: what stands there before it moves is not cut, what comes back is."""
    model = replace(
        HammersteinModel.load("duo_bimorph_static"),
        voltages=Voltages.of([0.0, 0.0], [0.0, 0.0], [20.0, 20.0]),
    )
    plant = Plant(model, Instruments(drive=Drive(range_v=(0.0, 20.0))))
    asked, path = np.array([[0.0, 0.0, 5.0, 0.0, 0.0, 0.0]] * 2), np.zeros((2, 6))
    asked[1] = 0.0
    whole = plant.carry_on(asked, plant.rest([1]), path)[0].saturated
    assert whole.tolist() == [[False, False, False, True, True, True], [False] * 6]
    parts, state = [], plant.rest([1])
    for first in range(0, 6, 2):
        part = slice(first, first + 2)
        response, state = plant.carry_on(asked[:, part], state, path[:, part])
        parts.append(response.saturated)
    assert np.hstack(parts).tolist() == whole.tolist()


def test_the_chain_gives_the_numbers_of_its_equations_to_the_last_bit():
    """Worked through piece by piece and compiled, against NumPy over the whole run at once."""
    model, samples = HammersteinModel.load("duo_bimorph_creep"), 2 * BLOCK + 77
    drive, sensor = Drive(range_v=[(-9.0, 8.0), (-10.0, 10.0)]), Sensor(range_um=40.0)
    plant = Plant(model, Instruments(drive=drive, sensor=sensor))
    asked = np.random.default_rng(5).uniform(-11.0, 11.0, (2, samples))
    response = plant.respond(asked, [3])
    low, high = drive.steps(2)[:, :, None]
    held = np.round(np.clip(asked, low, high) / drive.resolution_v) * drive.resolution_v
    both = plant.block.respond(model.hysteresis.respond(held)[0])[0]
    noisy = both[2:] + sensor.noise_um * standard_noise(np.random.default_rng([3]), 2, samples)
    reading = np.round(np.clip(noisy, -40.0, 40.0) / sensor.resolution_um) * sensor.resolution_um
    for name, wire in {"drive_v": held, "position_um": both[:2], "reading_um": reading}.items():
        assert (getattr(response, name) == wire).all(), name
    assert (response.saturated == (np.abs(asked - [[-0.5], [0.0]]) > [[8.5], [10.0]])).all()


@pytest.mark.parametrize(
    ("value", "told"),
    [(1e11, r"requested of axis 2 reaches 1e\+11 V after 0.8194 s"), (np.nan, "at sample 16387")],
)
def test_a_long_run_that_leaves_all_bounds_says_where(value, told):
    plant = Plant(HammersteinModel.load("duo_bimorph_static"), Instruments.ideal())
    asked = np.zeros((2, 2 * BLOCK))
    asked[1, BLOCK + 3] = value
    with pytest.raises(SimulationError, match=told):
        plant.respond(asked, [0])


@pytest.mark.parametrize("law", ["hammerstein_inverse", "feedback"])
def test_laws_that_need_the_whole_path_say_so(law):
    compensators = [{"label": "c", "law": law, "model": "duo_bimorph"}]
    with pytest.raises(InputError, match="works on the whole path"):
        list(simulate_in_blocks(_scenario(reference=PATH, compensators=compensators)))


def test_a_run_that_does_not_fit_the_memory_is_refused_before_it_begins():
    slow = {"kind": "sine", "amplitude_v": 10.0, "frequency_hz": 1e-6}
    with pytest.raises(SimulationError, match=r"needs about .* GB of memory.*record_every"):
        run(_scenario(drive=slow))


def test_a_law_that_knows_the_actuator_itself_says_so():
    reference = {"kind": "sine", "amplitude_um": 20.0, "frequency_hz": 50.0, "axis": 1}
    sources = ({"model": "duo_bimorph"}, {"model": "duo_bimorph_static"}, {"identification": {}})
    laws = [{"label": f"law {k}", "law": "none", **source} for k, source in enumerate(sources)]
    said = [s for s in run(_scenario(reference=reference, compensators=laws)).statements if "itself" in s]
    assert said == [
        "law 0: designed from the simulated actuator itself. On a real actuator, the model error is added."
    ]


def test_samples_may_be_recorded_further_apart_than_a_block_is_long(monkeypatch):
    monkeypatch.setattr("hammerstein.experiment.measure.RECORDED_BLOCK", 30)
    drive = {"kind": "sine", "amplitude_v": 10.0, "frequency_hz": 10.0, "axis": 1}
    measure = {"settle_cycles": 1, "measured_cycles": 1, "record_every": 40}
    (trace,) = run(_scenario(actuator="duo_bimorph_static", drive=drive, measure=measure)).traces
    assert trace.response.drive_v.shape[1] == 2000 // 40


@pytest.mark.full
def test_a_run_of_which_one_in_n_samples_is_recorded(tmp_path):
    """The same numbers as the whole run has on those samples; models predict from every sample."""
    content = {
        "drive": {"kind": "sine", "amplitude_v": 10.0, "frequency_hz": 1.0, "axis": 1},
        "models": [{"label": "table", "model": "duo_bimorph_static"}],
        "measure": {"settle_cycles": 4, "measured_cycles": 2, "record_every": 40},
    }
    scenario = _scenario(actuator="duo_bimorph_creep", **content)
    report = run(scenario)
    (trace,) = report.traces
    whole = simulate(scenario)
    assert whole.drive_v.shape[1] > 100_000  # more than one piece
    assert trace.response.sample_time_s == pytest.approx(40 * 50e-6)
    for name in ("drive_v", "position_um", "reading_um"):
        expected = getattr(whole, name)[:, ::40][:, trace.first_sample :]
        np.testing.assert_array_equal(getattr(trace.response, name), expected, name)
    thresholds = [[table.R_V] * 2] * 2
    predicted = table.prandtl_ishlinskii(whole.drive_v, thresholds, table.W_UM_PER_V)
    error = (whole.reading_um - predicted)[:, ::40][:, trace.first_sample :]
    assert trace.first_sample == 4 * 20_000 // 40
    rms = [row.rms_um for row in report.rows]
    np.testing.assert_allclose(rms, np.sqrt(np.mean(error**2, axis=1)), rtol=1e-9)
    assert any("One of 40 samples was recorded" in text for text in report.statements)


def test_one_cut_voltage_among_the_samples_not_recorded_counts():
    drive = {"kind": "sine", "amplitude_v": 10.02, "frequency_hz": 50.0, "axis": 1}
    counts = {}
    for every in (1, 20):
        measure = {"settle_s": 0.0, "measured_cycles": 1, "record_every": every}
        counts[every] = run(_scenario(drive=drive, measure=measure)).rows[0].saturated_samples
    beyond = np.abs(10.02 * np.sin(2 * np.pi * 50.0 * 50e-6 * np.arange(800, 1200))) > 10.0
    assert counts[1] == beyond.sum()
    assert counts[20] == beyond.reshape(-1, 20).any(axis=1).sum()


@pytest.mark.parametrize(
    ("actuator", "sample_time_s", "told"),
    [
        ("duo_bimorph_static", 50e-6, ""),
        ("duo_bimorph_static", 2e-3, "the numbers in this report are errors at the samples."),
        ("duo_bimorph", 2e-3, "Only laws and models with dynamics correct this."),
    ],
)
def test_what_the_hold_alone_costs_is_told(actuator, sample_time_s, told):
    """A held sine against the sine itself: fundamental by the sum, not by a formula."""
    scenario = _scenario(
        actuator=actuator,
        drive={"kind": "sine", "amplitude_v": 10.0, "frequency_hz": 10.0, "axis": 1},
        instruments={"drive": {"sample_time_s": sample_time_s}},
        models=[{"label": "m", "identification": {"frequency_hz": 50, "sample_time_s": 50e-6}}],
    )
    said = [text for text in run(scenario).statements if "is constant for" in text or "sample time" in text]
    assert bool(said) == bool(told)
    if told:
        assert said[0].endswith(told)
        time = (np.arange(10_000) + 0.5) * 1e-5
        held = np.sin(2 * np.pi * 10.0 * 2e-3 * np.floor(time / 2e-3))
        error = held - np.sin(2 * np.pi * 10.0 * time)
        off = 2.0 * abs(np.mean(error * np.exp(-2j * np.pi * 10.0 * time)))
        assert f"an error of {100 * off:.2g} % of a sine's amplitude" in said[0]
        assert "identified at a sample time of 50 us, run at 2 ms" in said[1]
