"""Hysteresis in the loop beside other models: recommended only where it is better on what it has not seen."""

from __future__ import annotations

import json
from dataclasses import replace

import control
import numpy as np
import pytest
from scipy.interpolate import interp1d
from typer.testing import CliRunner

import hammerstein
from hammerstein.commands.cli import app
from hammerstein.comparison import fitting
from hammerstein.comparison.compare import IN_LOOP as NAME, fit_in_loop
from hammerstein.dynamics import (
    AxesDynamics,
    Axis,
    ElastoSlip,
    ElectromechanicalDynamics,
    StackAxis,
    discretise,
    on_grid,
)
from hammerstein.errors import InputError
from hammerstein.hysteresis import Pair, PrandtlIshlinskii
from hammerstein.identification.in_loop.identify import LoopSettings
from hammerstein.identification.in_loop.parameters import SettledPeriod
from hammerstein.identification.in_loop.search import Selection
from hammerstein.identification.model_selection import Trial
from hammerstein.identification.options import PLAYS
from hammerstein.identification.score import Candidate
from hammerstein.identification.settings import Settings
from hammerstein.identification.state_space_candidates import gain_model
from hammerstein.records.record import Record
from hammerstein.reporting.compare_page import compare_page

TIME_S, SAMPLES = 1e-4, 1024
SHORT = LoopSettings(order=4, minutes=5.0)
KNOWN = Settings(
    thresholds_v=[0.0, 2.0, 8.0],
    dynamics="second_order",
    creep_modes=0,
    delay_samples=0,
    error_curve=False,
)
RESONANT = on_grid(AxesDynamics(axes=(Axis(resonance_hz=400.0, damping_ratio=0.05),)), TIME_S)


def stack():
    """A stack of 400 Hz: hysteresis between voltage and charge."""
    slips = tuple(
        ElastoSlip(stiffness_v_per_uc=k, threshold_uc=r) for k, r in ((0.3, 0.9), (0.2, 3.0), (0.1, 12.0))
    )
    numbers = {"mass_kg": 0.5, "stiffness_n_per_um": 3.16, "damping_ns_per_m": 120.0}
    axis = StackAxis(**numbers, capacitance_uf=2.0, force_n_per_v=1.2, stops=slips)
    return on_grid(ElectromechanicalDynamics(axes=(axis,)), TIME_S).respond


def cascade():
    """Plays of the thresholds of ``KNOWN`` in front of a resonance."""
    plays = PrandtlIshlinskii([[Pair([0.0, 2.0, 8.0], [1.0, 0.15, 0.15])]])
    return lambda u: RESONANT.respond(plays.respond(u)[0])


def record(respond, seed, level_v):
    """Two settled periods of a multisine, with half a percent of noise."""
    lines = np.zeros((1, SAMPLES // 2 + 1), dtype=complex)
    lines[:, 1:110] = np.exp(2j * np.pi * np.random.default_rng(seed).uniform(size=(1, 109)))
    u = np.fft.irfft(lines)
    u *= level_v / u.std()
    y = np.tile(respond(np.hstack([u, u, u]))[0][:, -SAMPLES:], 2)
    y = y + 0.005 * y.std() * np.random.default_rng(100 + seed).normal(size=y.shape)
    return Record(np.tile(u, 2), y, TIME_S, source=f"record {seed}", period_samples=SAMPLES)


def compared(respond, monkeypatch):
    """Plays and linear models beside the loop: other kinds take long."""
    monkeypatch.setattr(fitting, "identifiable_kinds", lambda: (PLAYS,))
    records = [record(respond, k, (3.0, 6.0, 12.0)[k % 3]) for k in range(6)]
    held = [record(respond, 50, 9.0)]
    return hammerstein.compare(records, KNOWN, validation=held, in_loop=SHORT)


def test_errors_of_any_model_are_those_of_its_simulation():
    """A constant error of the gain of 10 %: a tenth of the readings is left, in parts of their range."""
    u = record(cascade(), 1, 6.0).u_v[:, :SAMPLES]
    block = discretise(AxesDynamics(axes=(Axis(resonance_hz=400.0, damping_ratio=0.05),)), TIME_S)
    y = block.respond(np.tile(u, 3))[0][:, -SAMPLES:]
    periods = [SettledPeriod(k * u, k * y, 1.0, 2 * SAMPLES) for k in (0.5, 1.0, 2.0)]
    one = Candidate(
        gain_model(np.array([[0.9]])), AxesDynamics(axes=(Axis(resonance_hz=400.0, damping_ratio=0.05),))
    )
    parts = Selection.of(periods)
    found = parts.of_model(one, Trial("any", 3, np.zeros(4)), record(cascade(), 1, 6.0))
    assert len(found.squares) == 1
    assert found.parameters == 3
    assert found.squares[0] == pytest.approx(0.01 * y.var() / np.ptp(y) ** 2, rel=1e-6)


@pytest.mark.full
def test_a_resonance_that_moves_with_the_amplitude_is_given_to_the_loop(monkeypatch):
    found = compared(stack(), monkeypatch)
    ours, unseen = found[NAME], found.unseen
    assert found.recommended == found.best == NAME
    assert [entry.name for entry in found.entries if entry.as_good] == [NAME]
    assert unseen.percent < 0.3 * unseen.rival_percent
    assert ours.folds_percent == unseen.percent
    assert (
        ours.validation.mean_percent < 0.3 * found["prandtl_ishlinskii with dynamics"].validation.mean_percent
    )
    assert unseen.sentence() in found.sentences()
    assert "Hysteresis in the loop is judged" in compare_page(found).markdown()
    assert json.loads(found.to_json())["unseen"]["experiments"] == 2
    path = 2.0 * np.sin(2 * np.pi * 40.0 * np.arange(800) * TIME_S)[None] * np.linspace(0.0, 1.0, 800)
    error = ours.model.simulate(ours.model.compensate(path).drive_v, TIME_S).position_um - path
    assert error.std() < 1e-3 * path.std()


@pytest.mark.full
def test_a_cascade_is_not_given_to_the_loop(monkeypatch):
    """Plays in front of a resonance, which move no pole: a loop that imitates them is no better."""
    found = compared(cascade(), monkeypatch)
    assert found.recommended == "prandtl_ishlinskii with dynamics"
    if found.unseen is not None:
        assert found.unseen.percent > 0.95 * found.unseen.rival_percent


def test_a_loop_that_fails_leaves_the_others():
    """Two experiments are too few; the reason stands beside the kinds that could not be fitted."""
    records = [record(cascade(), k, 3.0 * (k + 1)) for k in range(2)]
    given = fit_in_loop(records, SHORT, (), [], lambda text: None)
    assert (given.name, given.hysteresis) == (NAME, PLAYS)
    assert "there are 2" in given.reason


def behind(respond, hz, parts=8):
    """The same seen by a sensor of first order, which sees what happens within a sample."""
    sensor = control.tf([1.0], [1.0 / (2.0 * np.pi * hz), 1.0])

    def read(u):
        y = interp1d(np.arange(u.shape[1]), respond(u)[0], kind="cubic", fill_value="extrapolate")
        fine = np.arange(u.shape[1] * parts) / parts
        return control.forced_response(sensor, fine * TIME_S, y(fine)[0]).outputs[None, ::parts], None

    return read


@pytest.mark.full
def test_a_known_sensor_is_no_part_of_any_model(monkeypatch):
    """All models are judged beside each other as if the readings had been those of an ideal sensor."""
    monkeypatch.setattr(fitting, "identifiable_kinds", lambda: (PLAYS,))
    levels_v, hz = (3.0, 6.0, 12.0), 1500.0
    plain, seen = ([record(r, k, levels_v[k % 3]) for k in range(6)] for r in (stack(), behind(stack(), hz)))
    ideal = hammerstein.compare(plain, KNOWN, in_loop=SHORT)
    late = [replace(r, y_um=np.roll(r.y_um, 1, axis=1), period_samples=None) for r in seen]
    sensor = {"sensor_bandwidth_hz": hz, "sensor_delay_s": TIME_S}
    known = hammerstein.compare(late, KNOWN.changed(**sensor), in_loop=SHORT)
    unknown = hammerstein.compare(seen, KNOWN, in_loop=SHORT)
    assert known.recommended == NAME
    assert len({tuple(entry.fitted_at) for entry in known.entries}) == 1  # one set of frequencies for a table
    assert known.unseen.rival_percent == pytest.approx(ideal.unseen.rival_percent, rel=0.05)
    assert known[NAME].model.instruments.sensor.bandwidth_hz == hz
    u = record(stack(), 50, 9.0).u_v
    expected = stack()(u)[0]
    errors = [
        (one[NAME].model.simulate(u, TIME_S).position_um - expected)[:, SAMPLES:].std()
        for one in (ideal, known, unknown)
    ]
    assert errors[1] < 1.5 * errors[0]
    assert errors[2] > 5.0 * errors[0]


def test_the_command_takes_a_known_sensor(tmp_path, monkeypatch):
    """Both commands give it to the search."""
    files, asked = [], []
    for k in range(3):
        one = record(cascade(), k, 3.0 * (k + 1))
        files.append(str(tmp_path / f"{k}.csv"))
        head = ",".join([*(f"{n} [V]" for n in one.inputs), *(f"{n} [um]" for n in one.outputs)])
        np.savetxt(files[-1], np.vstack([one.u_v, one.y_um]).T, delimiter=",", header=head, comments="")

    def stopped(records, settings=None, **more):
        asked.append(more.get("in_loop") or settings)
        raise InputError("records", "were given")

    monkeypatch.setattr("hammerstein.identification.in_loop.identify.identify_in_loop", stopped)
    monkeypatch.setattr("hammerstein.comparison.compare.compare", stopped)
    words = ["--rate", f"{1.0 / TIME_S:g}", "--hysteresis-in-loop", "--accept-gain", "--accept-order"]
    sensor = ["--sensor-bandwidth", "2000", "--sensor-delay", "1e-4", "--order", "6", "--minutes", "2"]
    for command, out in (("identify", "m.json"), ("compare", "out")):
        done = CliRunner().invoke(app, [command, *files, *words, *sensor, "--out", str(tmp_path / out)])
        assert "were given" in str(done.exception)
    assert asked == 2 * [
        LoopSettings(order=6, minutes=2.0, sensor_bandwidth_hz=2000.0, sensor_delay_s=1e-4, accept_order=True)
    ]
