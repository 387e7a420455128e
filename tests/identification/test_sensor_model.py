"""A sensor that is known to report late: its delay is no part of the model."""

from __future__ import annotations

import control
import numpy as np
import pytest
from record_cases import message, plain
from test_second_order import AXES, SENSOR_HZ, R, T, campaign, record_of

from hammerstein.comparison.compare import compare
from hammerstein.dynamics import StaticDynamics
from hammerstein.identification.identify import identify
from hammerstein.identification.score import SensorModel
from hammerstein.identification.settings import Settings
from hammerstein.records.checks import FEWEST_SAMPLES
from hammerstein.records.record import Record
from hammerstein.reporting.fit_page import fit_page

PARTS = 8
"""Parts of a sample in which the truth is computed."""


def late_records(late: int, noise: float = 0.02, every: int = 1) -> list[Record]:
    """The campaign with readings so many eighths of a sample late; ``every`` takes a coarser grid."""
    generator, found = np.random.default_rng(3), []
    for record in campaign(0.0):
        held = np.repeat(record.u_v[:, ::every], every, axis=1)
        fine = record_of(np.repeat(held, PARTS, axis=1), 0.0, generator, delay=late, sample_time_s=T / PARTS)
        y = fine.y_um[:, :: PARTS * every]
        y = y + noise * generator.standard_normal(y.shape)
        found.append(Record(record.u_v[:, ::every], y, T * every))
    return found


def known(late: int, **options) -> Settings:
    """Second-order axes behind the true thresholds, and a sensor so many eighths of a sample late."""
    sensor = {"sensor_bandwidth_hz": SENSOR_HZ, "sensor_delay_s": late / PARTS * T}
    return plain(dynamics="second_order", thresholds_v=R, **(sensor | options))


@pytest.mark.parametrize("periodic", [True, False])
@pytest.mark.parametrize(("hz", "late"), [(400.0, 0.0), (3000.0, 3.4), (None, 0.6)])
def test_a_reading_is_freed_of_lag_and_delay(periodic, hz, late):
    """Smooth motion, of which the sensor is computed on a grid sixteen times as fine."""
    parts, n, cycles = 16, 400, 3
    fine_s = T / parts
    time_s = fine_s * np.arange(cycles * n * parts)
    offsets = np.array([[0.1], [1.0], [2.0]])
    grown = 1.0 if periodic else np.clip(time_s / time_s[-1] * 2.0, 0.0, 1.0) ** 3 * (time_s > 0.0)
    lines = 2.0 * np.pi * np.outer([1, 7, 23], time_s) / (n * T)
    y = grown * np.sum([[1.0], [0.3], [0.1]] * np.sin(lines + offsets), axis=0)
    sensor = control.tf([1.0], [1.0 / (2.0 * np.pi * hz), 1.0]) if hz else control.tf([1.0], [1.0])
    read = control.forced_response(sensor, time_s, y).outputs
    read = np.interp(time_s - late * T, time_s, read)
    u, given = np.sin(lines[:1, ::parts]), slice((cycles - 2) * n if periodic else 0, None)
    record = Record(u[:, given], read[None, ::parts][:, given], T, period_samples=n if periodic else None)
    known = SensorModel(hz, late * T)
    found = known.freed(known.prompt(record)).y_um[0]
    expected = y[::parts][given][: len(found)]
    inside = slice(0, None if periodic else -20)
    missed, before = (np.abs(y - expected) for y in (found, record.y_um[0, : len(found)]))
    assert missed[inside].max() < 2e-3 * np.ptp(expected)
    assert missed[inside].max() < 0.2 * before[inside].max()
    assert missed.max() < 0.02 * np.ptp(expected)  # the end of a record that does not repeat


MORE = [pytest.param(*each, marks=pytest.mark.long) for each in ((8, 8), (19, 0), (6, 0))]


@pytest.mark.full
@pytest.mark.parametrize(("sensor", "actuator"), [(19, 5), *MORE])
def test_a_known_delay_of_the_sensor_is_not_the_actuators(sensor, actuator):
    model, fit = identify(late_records(sensor + actuator), known(sensor))
    assert model.dynamics.input_delay_s == pytest.approx(actuator / PARTS * T, abs=0.05 * T)
    assert fit.delay_samples == pytest.approx(actuator / PARTS, abs=0.05)
    for axis, (resonance_hz, damping) in zip(model.dynamics.axes, AXES, strict=True):
        assert axis.resonance_hz == pytest.approx(resonance_hz, rel=2e-3)
        assert axis.damping_ratio == pytest.approx(damping, rel=1e-2)
    assert max(fit.fit["hammerstein"].rms_um) < 0.03
    page = fit_page(model, fit).markdown()
    assert f"| sensor delay, as given | {sensor / PARTS * T:.4g} s" in page
    assert "without the sensor's" in page
    assert "assigned to the actuator" not in page
    assert "hold for this delay" in page


@pytest.mark.full
def test_records_of_several_sample_times_have_one_delay():
    late = 19
    records = [*late_records(late)[::2], *late_records(late, every=2)[1::2]]
    model, fit = identify(records, known(late, delay_samples=0))
    for axis, (resonance_hz, _) in zip(model.dynamics.axes, AXES, strict=True):
        assert axis.resonance_hz == pytest.approx(resonance_hz, rel=2e-3)
    assert max(fit.fit["hammerstein"].rms_um) < 0.03
    assert model.dynamics.input_delay_s == 0.0


@pytest.mark.long  # it fits every kind
def test_a_comparison_judges_with_the_sensor_that_is_given():
    found = compare(late_records(16), known(16, delay_samples=0), validation=late_records(16)[:2])
    assert found["prandtl_ishlinskii with dynamics"].judged.rms_um[0] < 0.03


def test_static_plays_see_whole_samples_and_parts():
    u = 10.0 * np.sin(2.0 * np.pi * np.arange(1500) / 300.0)
    late = Record([u[2:]], [3.0 * u[:-2]], 1e-3)  # held voltages: a reading 1.4 samples late is two late
    model, fit = identify([late], plain(operators=1, sensor_delay_s=1.4e-3))
    first = 3.0 * (u[2] - u[1])  # what went before the record is not known
    assert fit.fit[fit.kind].rms_um[0] < 1.01 * abs(first) / np.sqrt(late.samples)
    assert model.dynamics.input_delay_s == 0.0


def test_a_period_goes_on_at_its_beginning():
    u = np.sin(2.0 * np.pi * np.arange(200) / 100.0)
    record = Record([u], [np.roll(2.0 * u, 3)], 1e-3, period_samples=100)
    prompt = SensorModel(delay_s=3e-3).prompt(record)
    assert prompt.samples == 200
    assert np.array_equal(prompt.y_um, 2.0 * prompt.u_v)


@pytest.mark.parametrize("more", [0, -1])
def test_a_delay_may_leave_the_fewest_samples_that_a_record_has(more):
    u = np.sin(np.linspace(0.0, 12.0, FEWEST_SAMPLES + 5))[None]
    record, sensor = Record(u, 2.0 * u, 1e-3), SensorModel(delay_s=1e-3 * (5 - more))
    if more == 0:
        assert sensor.prompt(record).samples == FEWEST_SAMPLES
    else:
        assert "but the sensor delay is 6 samples" in message(sensor.prompt, record)


@pytest.mark.parametrize("bandwidth_hz", [None, 200.0])
@pytest.mark.parametrize("sensor_s", [0.0, 4e-4, 2e-3])
@pytest.mark.parametrize("actuator_s", [0.0, 3e-4])
def test_a_gain_has_a_path_where_anything_makes_it_late(actuator_s, sensor_s, bandwidth_hz):
    """But for whole samples of the sensor, which a prompt record has lost already."""
    u = np.sin(np.linspace(0.0, 12.0, 300))[None]
    sensor = SensorModel(bandwidth_hz, sensor_s)
    paths = sensor.paths(StaticDynamics(n_outputs=1, input_delay_s=actuator_s), [Record(u, u, 1e-3)] * 2)
    part_s = actuator_s + sensor_s % 1e-3
    assert len(paths) == 2 * bool(bandwidth_hz or part_s)
    if bandwidth_hz is None:
        for path in paths:
            late = path.respond(np.arange(9.0)[None])[0][0, -1]  # held over a sample: what came before
            assert late == pytest.approx(8.0 - np.ceil(part_s / 1e-3))


def test_mistakes_name_the_delay():
    for wrong in (-1e-6, float("nan"), float("inf")):
        assert "sensor_delay_s" in message(lambda wrong=wrong: Settings(sensor_delay_s=wrong))
    for sensor in ({"sensor_delay_s": 1e-4}, {"sensor_bandwidth_hz": 2000.0}):
        said = message(lambda sensor=sensor: Settings(dynamics="state_space", **sensor))
        assert f"{next(iter(sensor))}  cannot be separated from dynamics state_space" in said
    record = late_records(0)[0]
    said = message(lambda: identify([record], plain(sensor_delay_s=0.995 * record.samples * T)))
    assert "the sensor delay is 1492 samples" in said
