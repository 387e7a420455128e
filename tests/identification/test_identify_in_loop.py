"""From records to hysteresis in the loop: the command, its rival, its resumption and what it refuses."""

from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter
from typer.testing import CliRunner

from hammerstein import HammersteinModel
from hammerstein.commands.cli import app
from hammerstein.dynamics import ElastoSlip, ElectromechanicalDynamics, StackAxis, on_grid
from hammerstein.errors import IdentificationError, InputError
from hammerstein.identification.in_loop.identify import LoopSettings, identify_in_loop
from hammerstein.identification.in_loop.search import Selection, settled_periods, with_period
from hammerstein.identification.model_selection import Trial
from hammerstein.records.record import Record

TIME_S, SAMPLES = 1e-4, 1024
LEVELS_V = (3.0, 6.0, 12.0)
SHORT = LoopSettings(order=4, minutes=5.0)


def stack(soft=1.0):
    """One axis of 400 Hz whose stops take ten percent of the voltage or so."""
    slips = tuple(
        ElastoSlip(stiffness_v_per_uc=0.1 * soft * k, threshold_uc=3.0 * r)
        for k, r in ((3, 0.3), (2, 1), (1, 4))
    )
    numbers = {"mass_kg": 0.5, "stiffness_n_per_um": 3.16, "damping_ns_per_m": 120.0}
    axis = StackAxis(**numbers, capacitance_uf=2.0, force_n_per_v=1.2, stops=slips)
    return on_grid(ElectromechanicalDynamics(axes=(axis,)), TIME_S)


def multisine(seed, amplitude):
    lines = np.zeros((1, SAMPLES // 2 + 1), dtype=complex)
    lines[:, 1:110] = np.exp(2j * np.pi * np.random.default_rng(seed).uniform(size=(1, 109)))
    u = np.fft.irfft(lines)
    return amplitude * u / u.std()


def settled(block, u):
    return block.respond(np.hstack([u, u, u]))[0][:, -SAMPLES:]


def records(block=None, count=6, levels_v=LEVELS_V):
    """Two settled periods of each experiment, with half a percent of noise."""
    block, found = block or stack(), []
    for k in range(count):
        u = multisine(k, levels_v[k % 3])
        y = np.tile(settled(block, u), 2)
        y = y + 0.005 * y.std() * np.random.default_rng(100 + k).normal(size=y.shape)
        found.append(Record(np.tile(u, 2), y, TIME_S, source=f"record {k}", period_samples=SAMPLES))
    return found


def held_percent(fit):
    """Error of the chosen structure on the experiments that chose it, in percent of the range."""
    return next(trial.percent for trial in fit.trials if trial.kept)


@pytest.mark.full
def test_what_is_found_holds_between_the_amplitudes_of_the_records():
    """At 9 V, which no record has: a tenth of what the best linear model leaves on what was held back."""
    truth = stack()
    model, fit = identify_in_loop(records(truth), SHORT)
    assert held_percent(fit) < 0.3 * fit.trials[0].percent
    u = multisine(50, 9.0)
    expected = settled(truth, u)
    found = model.simulate(np.tile(u, 3), TIME_S).position_um[:, -SAMPLES:]
    assert (found - expected).std() < 0.02 * expected.std()
    assert model.dynamics.instability() == ""


@pytest.mark.full
def test_a_model_has_what_its_records_have_and_its_error_on_one_that_was_not_fitted():
    """Sample time and voltages of the records; the error that validation shows is the simulation's own."""
    truth, u = stack(), multisine(60, 9.0)
    y = np.tile(settled(truth, u), 2)
    held = Record(np.tile(u, 2), y, TIME_S, source="held", period_samples=SAMPLES)
    here = records(truth)
    model, fit = identify_in_loop(here, SHORT, validation=[held])
    assert model.instruments.drive.sample_time_s == TIME_S
    assert model.voltages.working_point_v == (0.0,)
    assert model.voltages.highest_v == (max(float(one.u_v.max()) for one in here),)
    assert model.provenance["records"] == [one.source for one in here]
    error = y[:, -SAMPLES:] - model.simulate(np.tile(u, 3), TIME_S).position_um[:, -SAMPLES:]
    assert fit.validation["in_loop"].rms_um[0] == pytest.approx(error.std(), rel=0.02)
    assert model.verdict.held_out
    assert model.verdict.nrmse_percent[0] == pytest.approx(100.0 * error.std() / np.ptp(y), rel=0.02)


@pytest.mark.parametrize("kept", [1, 3])
@pytest.mark.parametrize("ratio", [0.05, 0.25, 0.5])
def test_a_period_counts_once_two_in_a_row_differ_by_a_thousandth(ratio, kept):
    """Of what dies out by a ratio from one to the next; of two outputs the slower one decides."""
    n, y = 32, np.sin(2.0 * np.pi * np.arange(32) / 32)

    def dying(u):
        parts = [y * (1.0 + 0.1 * ratio**k) for k in range(u.shape[1] // n)]
        return np.stack([np.tile(y, len(parts)), 1e-3 * np.concatenate(parts)]), None

    u = np.tile(y, kept)[None]
    record = Record(u, np.concatenate([u, 1e-3 * u]), TIME_S, period_samples=n, verified=True)
    (found,) = settled_periods([record], dying)
    needed = next(k for k in range(9) if 0.1 * ratio**k * (1.0 - ratio) < 1e-3)
    assert found.warm == n * (needed + 1)


ONE = "all records have one amplitude; several are needed to tell what changes with the amplitude"


@pytest.mark.parametrize(("levels_v", "said"), [((6.0, 6.1, 5.9), True), ((3.0, 6.0, 12.0), False)])
def test_records_of_one_amplitude_are_told(levels_v, said):
    assert (ONE in identify_in_loop(records(levels_v=levels_v), SHORT)[1].notes) == said


@pytest.mark.parametrize(("part", "refused"), [(0.995, True), (0.98, False)])
def test_a_loop_must_be_better_than_linear_dynamics_by_one_percent(monkeypatch, part, refused):
    """As one structure must be than another; of equal errors chance tells which is less."""
    plain = Selection.of_loop

    def of_loop(self, found, pool):
        return replace(plain(self, found, pool), squares=part**2 * self.linear.squares)

    def of_linear(self, block):
        trial = Trial("linear", 1, np.array([1e-4]))
        object.__setattr__(self, "linear", trial)
        return trial

    monkeypatch.setattr(Selection, "of_loop", of_loop)
    monkeypatch.setattr(Selection, "of_linear", of_linear)
    told = pytest.raises(IdentificationError, match="does not improve") if refused else nullcontext()
    with told:
        identify_in_loop(records(), SHORT)


@pytest.mark.full
def test_a_settled_period_can_begin_anywhere():
    """Voltages count from 0 V, not from the first one, and wide plays stand where a period begins."""
    truth = stack()
    begun = records(truth)
    turned = [
        replace(one, u_v=np.roll(one.u_v, -first, axis=1), y_um=np.roll(one.y_um, -first, axis=1))
        for one in begun
        for first in [int(np.argmin(one.u_v[0, :SAMPLES]))]
    ]
    fits = [identify_in_loop(some, SHORT)[1] for some in (begun, turned)]
    assert max(fit.fit["in_loop"].nrmse_percent[0] for fit in fits) < 0.06  # the noise is 0.05 %


def test_settled_periods_need_not_be_stated():
    """As from a CSV file: the same model as with their length, and one note."""
    here = records()
    model, fit = identify_in_loop([replace(one, period_samples=None) for one in here], SHORT)
    stated, known = identify_in_loop(here, SHORT)
    assert model.digest() == stated.digest()
    assert [note for note in fit.notes if note not in known.notes] == [
        "taken for settled periods, because voltages and outputs repeat: 6 records"
    ]


@pytest.mark.full
def test_a_record_that_begins_in_motion_is_flagged_and_those_from_rest_are_not():
    """Noise up to 1 kHz at three levels, from rest; one record is cut where the stack moves."""
    found, block = [], stack()
    for k in range(7):
        drawn = np.random.default_rng(k).normal(size=(1, 3000)) * (np.arange(3000) >= 10)  # at rest before
        u = LEVELS_V[k % 3] * lfilter([0.1], [1.0, -0.9], drawn)
        y = block.respond(u)[0]
        y = y + 0.002 * y.std() * np.random.default_rng(100 + k).normal(size=y.shape)
        found.append(Record(u, y, TIME_S, source=f"record {k}"))
    _, clean = identify_in_loop(found[:6], LoopSettings(order=2, minutes=5.0))
    assert not any("does not begin at rest" in flag for flag in clean.flags)
    cut = Record(found[6].u_v[:, 711:], found[6].y_um[:, 711:], TIME_S, source="cut")
    _, spoilt = identify_in_loop([*found[:6], cut], LoopSettings(order=2, minutes=5.0))
    assert [flag.split(":")[0] for flag in spoilt.flags if "rest" in flag] == ["cut does not begin at rest"]


def test_outputs_that_lead_can_be_accepted():
    angle = 2.0 * np.pi * np.arange(2 * SAMPLES) / SAMPLES
    early = [Record([k * np.sin(angle)], [k * np.sin(angle + 0.2)], TIME_S) for k in LEVELS_V]
    with pytest.raises(InputError, match="leads"):
        identify_in_loop(early, SHORT)
    with pytest.raises(KeyboardInterrupt):
        identify_in_loop(early, SHORT.changed(accept_order=True), progress=lambda text: stop())


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("sensor_bandwidth_hz", value) for value in (0.0, -1000.0, np.nan)),
        *(("sensor_delay_s", value) for value in (-1.0, np.nan)),
        *(("order", value) for value in (0, -2, 2.5, True, 500)),
        *(("minutes", value) for value in (0.0, -1.0, np.nan)),
    ],
)
def test_settings_that_cannot_be_are_refused_by_name(name, value):
    with pytest.raises(InputError, match=name):
        LoopSettings(**{name: value})


def triangle(amplitude):
    return amplitude * (2.0 * np.abs(np.arange(SAMPLES)[None] / SAMPLES - 0.5) - 0.5)


@pytest.mark.parametrize("wave", [triangle(24.0), multisine(3, 6.0)], ids=["triangle", "multisine"])
@pytest.mark.parametrize("noise", [0.0, 0.005])
@pytest.mark.parametrize("read_v", [0.0, 1e-4])
@pytest.mark.parametrize("periods", [2, 3.5])
@pytest.mark.parametrize("settles", [True, False])
def test_periods_are_seen_where_they_settled(wave, noise, read_v, periods, settles):
    """Of voltages that were measured, too: to 1e-4 of their range. From rest they are none."""
    rng, before = np.random.default_rng(1), 3 * SAMPLES * settles
    u = np.tile(wave, 8)[:, : before + int(periods * SAMPLES)]
    y = stack().respond(u)[0][:, before:]
    shake = lfilter([1.0], [1.0, -1.8, 0.9], rng.normal(size=y.shape))  # noise through a resonance
    y = y + noise * y.std() * shake / shake.std()
    u = u[:, before:]
    u = u + read_v * np.ptp(u) * rng.normal(size=u.shape)
    record = Record(u, y, TIME_S)
    assert with_period(record).period_samples == (SAMPLES if settles else None)
    other = Record(np.hstack([u[:, :-9], 0.9 * u[:, -9:]]), y, TIME_S)
    assert with_period(other) is other


def test_linear_records_keep_the_linear_model():
    """Stops that never slip, and take nearly nothing: a loop has nothing to tell."""
    with pytest.raises(IdentificationError, match="does not improve the model"):
        identify_in_loop(records(stack(1e-9)), SHORT)


def interrupted(here, where, **files):
    """Until what it tells begins so."""

    def tell(text):
        if text.startswith(where):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        identify_in_loop(here, SHORT, progress=tell, **files)


def test_an_interrupted_search_ends_as_one_that_was_not(tmp_path):
    """Interrupted twice: while it looks for the structure, and while it fits all experiments."""
    kept, here = tmp_path / "search.json", records()
    whole, told = [], []
    model, fit = identify_in_loop(here, SHORT, progress=whole.append)
    last = next(text for text in reversed(whole) if ", step 0" in text and not text.startswith("all"))
    for where in (last, "all experiments, step 2 "):
        interrupted(here, where, kept=kept)
    again, found = identify_in_loop(here, SHORT, kept=kept, progress=told.append)
    assert again.digest() == model.digest()
    assert [(one.name, one.percent) for one in found.trials] == [
        (one.name, one.percent) for one in fit.trials
    ]
    assert told[0] == "continuing the interrupted search"
    assert all(text.startswith("all experiments") for text in told[1:])  # nothing is searched twice


def test_an_interrupted_search_leaves_a_model_that_can_be_played(tmp_path):
    """Its output at 9 V, which no record has, differs from the stage's by less than 10 %."""
    here, u, file = records(), multisine(50, 9.0), tmp_path / "m.partial.json"
    interrupted(here, "all experiments, step 2 ", playable=file)
    expected = settled(stack(), u)
    found = HammersteinModel.load(file).simulate(np.tile(u, 3), TIME_S).position_um[:, -SAMPLES:]
    assert (found - expected).std() < 0.1 * expected.std()


def test_a_model_so_far_gives_way_to_better_ones_alone(tmp_path, monkeypatch):
    """A larger order begins worse than the smaller one ended."""
    place, told, written = "hammerstein.identification.in_loop.identify", [], []

    def model_so_far(*_):
        written.append(told[-1])
        return SimpleNamespace(save=lambda file: None)

    monkeypatch.setattr(f"{place}.EVERY_S", 0.0)
    monkeypatch.setattr(f"{place}.model_so_far", model_so_far)
    identify_in_loop(records(), SHORT.changed(order=None), playable=tmp_path / "m.json", progress=told.append)
    percent = [
        float(text.split(": ")[1].split(" %")[0])
        for text in written
        if text.endswith("selection experiments")
    ]
    assert len(percent) > 5
    assert percent == sorted(percent, reverse=True)
    assert any(text.startswith("order 4") for text in told)


def test_the_time_before_an_interruption_counts(tmp_path, monkeypatch):
    """A stage that the clock cut is not searched again, unless there is more time now."""
    kept, here, told, more = tmp_path / "search.json", records(), [], []
    now_s = iter(range(10**6))
    monkeypatch.setattr("hammerstein.identification.in_loop.identify.time.monotonic", lambda: next(now_s))
    short, long = SHORT.changed(minutes=0.5), SHORT.changed(minutes=10000.0)
    with pytest.raises(KeyboardInterrupt):
        identify_in_loop(here, short, kept=kept, progress=lambda text: text.startswith("all") and stop())
    _, cut = identify_in_loop(here, short, kept=kept, progress=told.append)
    assert all(text.startswith("all experiments") for text in told[1:])
    _, whole = identify_in_loop(here, long, kept=kept, progress=more.append)
    assert any("2 products" in text for text in more)
    note = "the time limit of 0.5 minutes ended the search; --minutes gives it more"
    assert [note in fit.notes for fit in (cut, whole)] == [True, False]
    assert not any("time limit" in note for note in whole.notes)


def stop():
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("change", "order"), [(lambda r: replace(r, y_um=2.0 * r.y_um), 4), (lambda r: r, 2), (lambda r: r, None)]
)
def test_the_file_of_another_search_is_refused(tmp_path, change, order):
    kept, here = tmp_path / "search.json", records()
    interrupted(here, "all experiments", kept=kept)
    with pytest.raises(InputError, match=r"other records, of another order .*; remove it"):
        identify_in_loop([change(one) for one in here], SHORT.changed(order=order), kept=kept)


@pytest.mark.parametrize(
    "text", ['{"A": [1]}', "[]", "{", '{"format": "hammerstein-feedback-search/1", "search": {}, "A": []}']
)
def test_a_broken_or_older_file_is_to_be_removed(tmp_path, text):
    kept = tmp_path / "search.json"
    kept.write_text(text)
    with pytest.raises(InputError, match="remove it to start again"):
        identify_in_loop(records(), SHORT, kept=kept)


def test_too_few_experiments_are_refused():
    with pytest.raises(IdentificationError, match="there are 2"):
        identify_in_loop(records(count=2), SHORT)


@pytest.mark.parametrize(("inputs", "outputs"), [(2, 1), (1, 2)])
def test_other_numbers_of_inputs_and_outputs_are_refused_before_the_search(inputs, outputs):
    told, rng = [], np.random.default_rng(1)
    here = [
        replace(
            r,
            u_v=r.u_v[[0] * inputs] + rng.normal(size=(inputs, 1)),
            y_um=r.y_um[[0] * outputs],
            inputs=(),
            outputs=(),
            rest_v=np.zeros(inputs),
        )
        for r in records()
    ]
    what = f"have {inputs} inputs? and {outputs} outputs?; hysteresis in the loop needs equal numbers"
    with pytest.raises(InputError, match=what):
        identify_in_loop(here, SHORT, progress=told.append)
    assert told == []


@pytest.fixture
def arrays(tmp_path):
    here = records()
    shape = (len(here), 1, 2, SAMPLES)
    places = SimpleNamespace(u=tmp_path / "u.npy", y=tmp_path / "y.npy", out=tmp_path / "m.json")
    np.save(places.u, np.array([r.u_v for r in here]).reshape(shape))
    np.save(places.y, np.array([r.y_um for r in here]).reshape(shape))
    return places


def test_the_command_writes_a_model_and_no_search(arrays):
    words = ["identify", str(arrays.u), str(arrays.y), "--axes", "experiment,channel,period,sample"]
    words += [
        "--rate",
        "10000",
        "--hysteresis-in-loop",
        "--order",
        "4",
        "--minutes",
        "5",
        "--out",
        str(arrays.out),
    ]
    done = CliRunner().invoke(app, [*words, "--validate", str(arrays.u)])
    assert done.exit_code != 0
    assert not arrays.out.exists()
    done = CliRunner().invoke(app, words, terminal_width=1000)
    assert done.exit_code == 0, done.output
    assert "hysteresis in the loop" in done.output
    assert "Rms error about the mean of each record: " in done.output
    report = (arrays.out.parent / "m_fit" / "report.md").read_text()
    assert "Hysteresis in the loop improves the model" in report
    assert "| **order 4, 1 path of 4 plays in the loop, twice per sample** |" in report
    again = next(line for line in done.output.replace("\n", " ").split("then hammerstein ")[1:]).split()
    assert {"--hysteresis-in-loop", "--validate", "--axes"} <= set(again)
    assert HammersteinModel.load(arrays.out).dynamics.kind == "feedback_hysteresis"
    assert not [*arrays.out.parent.glob("*.search.json"), *arrays.out.parent.glob("*.partial.json")]


def test_another_identification_leaves_an_interrupted_search(arrays):
    """The same model file, without --hysteresis-in-loop: what the search has found so far stays."""
    search = arrays.out.with_name("m.search.json")
    search.write_text("{}")
    words = ["identify", str(arrays.u), str(arrays.y), "--axes", "experiment,channel,period,sample"]
    words += ["--rate", "10000", "--operators", "2", "--dynamics", "none", "--no-figures"]
    done = CliRunner().invoke(app, [*words, "--out", str(arrays.out)])
    assert done.exit_code == 0, done.output
    assert search.read_text() == "{}"


def test_options_of_other_models_are_refused_and_not_ignored(arrays):
    words = ["identify", str(arrays.u), str(arrays.y), "--axes", "experiment,channel,period,sample"]
    words += ["--rate", "10000", "--hysteresis-in-loop", "--operators", "8", "--hysteresis", "preisach"]
    done = CliRunner().invoke(app, [*words, "--out", str(arrays.out)], terminal_width=1000)
    assert done.exit_code != 0
    assert "does not use --operators, --hysteresis" in str(done.exception)
    assert not arrays.out.exists()
