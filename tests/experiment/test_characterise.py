from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
import theory
from shipped.paper_actuators import with_thresholds

from hammerstein.blocks.instruments import Drive, Instruments
from hammerstein.blocks.voltages import Voltages
from hammerstein.dynamics import StaticDynamics, discretise
from hammerstein.errors import IdentificationError, InputError
from hammerstein.experiment import simulated_identification
from hammerstein.experiment.run import run
from hammerstein.experiment.simulated_identification import identify_each
from hammerstein.identification.options import CascadeOptions, DynamicsKind, Partition
from hammerstein.identification.settings import Settings
from hammerstein.identification.static.closed_form import closed_form
from hammerstein.model import HammersteinModel
from hammerstein.model.simulation import Plant
from hammerstein.scenario.source import ClosedFormSpec, JointFitSpec
from hammerstein.signals import Lissajous, Triangle

T = 50e-6
JOINT = JointFitSpec(method="hammerstein")
EQUATION_12 = [0.07, 0.32, 0.74, 1.3, 2, 2.8, 3.67, 4.61, 5.54, 6.5, 7.34, 8.1, 8.8, 9.3, 9.7]


def identified(plant, spec, seed):
    (model,) = identify_each(plant, {spec: 1}, seed)
    return model


def _plant(name, **changes):
    model = HammersteinModel.load(name)
    instruments = changes.get("instruments", model.instruments)
    return Plant(model, instruments)


def test_closed_form_finds_the_printed_thresholds_and_loops():
    plant = _plant("duo_bimorph_static", instruments=Instruments.ideal())
    model = identified(plant, ClosedFormSpec(frequency_hz=50), 1)
    for row, printed in zip(model.hysteresis.pairs, plant.model.hysteresis.pairs, strict=True):
        for pair, own in zip(row, printed, strict=True):
            np.testing.assert_allclose(pair.thresholds_v, EQUATION_12, atol=0.05)
            assert pair.amplitude(10.0) == pytest.approx(own.amplitude(10.0), abs=0.02)
            areas = [theory.loop_area(p.thresholds_v, p.weights_um_per_v, 10.0) for p in (pair, own)]
            assert areas[0] == pytest.approx(areas[1], rel=0.03, abs=0.2)


def test_closed_form_is_the_same_about_any_voltage():
    """Plays count from where they rest: 40 to 60 V about 50 V are -10 to 10 V about 0 V."""
    about = HammersteinModel.load("duo_bimorph_static")
    raised = replace(about, voltages=Voltages.of([50.0] * 2, [40.0] * 2, [60.0] * 2))
    found = [identified(Plant(model, Instruments.ideal()), ClosedFormSpec(), 1) for model in (about, raised)]
    for row, other in zip(*(model.hysteresis.pairs for model in found), strict=True):
        for pair, one in zip(row, other, strict=True):
            np.testing.assert_allclose(pair.thresholds_v, one.thresholds_v, atol=1e-9)
            np.testing.assert_allclose(pair.weights_um_per_v, one.weights_um_per_v, atol=1e-9)


def test_a_triangle_finds_the_static_loop_at_thresholds_uniform_in_voltage():
    """A static block does not respond to how it is driven: the rising branch is met at every threshold."""
    plant = _plant("duo_bimorph_static", instruments=Instruments.ideal())
    model = identified(plant, ClosedFormSpec(frequency_hz=50, waveform="triangle"), 1)
    pair = model.hysteresis.pairs[0][0]
    assert np.ptp(np.diff(pair.thresholds_v)) < 1e-6
    points = 2.0 * pair.thresholds_v[1:] - 10.0
    found = theory.rising_branch(pair.thresholds_v, pair.weights_um_per_v, 10.0, points)
    np.testing.assert_allclose(found, theory.rising_branch(theory.R_V, theory.W_XX, 10.0, points), atol=1e-6)


def test_identification_hears_the_sensor_and_not_the_parameters():
    plant = _plant("duo_bimorph")
    a, b = (identified(plant, ClosedFormSpec(), seed) for seed in (1, 2))
    assert a.digest() != b.digest()
    quiet = Plant(plant.model, Instruments.ideal())
    c, d = (identified(quiet, ClosedFormSpec(), seed) for seed in (1, 2))
    assert c.digest() == d.digest()


@pytest.mark.full
@pytest.mark.parametrize(
    "name", [pytest.param("duo_bimorph", marks=pytest.mark.long), "duo_bimorph_resonant"]
)
def test_joint_fit_finds_resonance_damping_and_an_unseen_record(name):
    plant = _plant(name)
    model = identified(plant, JOINT, 1)
    for found, true in zip(model.dynamics.axes, plant.model.dynamics.axes, strict=True):
        assert found.resonance_hz == pytest.approx(true.resonance_hz, rel=3e-3)
        assert found.damping_ratio == pytest.approx(true.damping_ratio, rel=3e-2)
    time_s = np.arange(8000) * T
    triangle = Triangle(amplitude=8.0, frequency_hz=30.0, axis="all").sample(time_s, 2) * [[1.0], [0.7]]
    figure = Lissajous(amplitude=8.0, frequency_x_hz=50.0, frequency_y_hz=100 / 3).sample(time_s, 2)
    u = np.hstack([triangle, figure])
    true = plant.respond(u, [1]).position_um
    predicted, _ = discretise(model.dynamics, T).respond(model.hysteresis.respond(u)[0])
    assert (np.sqrt(np.mean((predicted - true)[:, 1600:] ** 2, axis=1)) < 0.15).all()


def test_records_of_a_joint_fit_go_from_rest_about_the_middle_of_the_range():
    model = HammersteinModel.load("duo_bimorph_static")
    offset = replace(model, voltages=Voltages.of([35.0, 55.0], [35.0, 35.0], [55.0, 55.0]))
    plant = Plant(offset, Instruments(drive=Drive(range_v=(30.0, 60.0))))
    drive = simulated_identification._Excursion.of(plant, None)
    for k, record in enumerate(simulated_identification._records(plant, JOINT, drive, [1, 2])):
        u = record.u_v[k]
        assert u[0] == pytest.approx([35.0, 55.0][k], abs=0.1)
        assert u.min() > 34.9
        assert u.max() < 55.1
        settled = u[len(u) // 2 :]  # where the voltage has long left its rest
        assert 0.5 * (settled.min() + settled.max()) == pytest.approx(45.0, abs=1.5)


@pytest.mark.full
def test_creep_is_found_from_a_slow_record_with_a_noise_of_its_own(monkeypatch):
    noises, respond = [], Plant.respond

    def noted(plant, voltage_v, seeds, *more):
        noises.append(tuple(seeds))
        return respond(plant, voltage_v, seeds, *more)

    monkeypatch.setattr(Plant, "respond", noted)
    plant = _plant("duo_bimorph_creep")
    model = identified(plant, JOINT.model_copy(update={"creep_modes": 3}), 1)
    frequency = np.array([0.002, 0.01, 0.1, 1.0])
    for found, true in zip(model.dynamics.axes, plant.model.dynamics.axes, strict=True):
        responses = [
            1 + sum(m.gain / (1 + 2j * np.pi * frequency * m.time_constant_s) for m in axis.creep)
            for axis in (found, true)
        ]
        np.testing.assert_allclose(responses[0], responses[1], atol=0.003)
    assert len(set(noises)) == len(noises) > 1


def test_too_many_operators_for_the_samples():
    with pytest.raises(IdentificationError, match="too few"):
        identified(_plant("duo_bimorph"), ClosedFormSpec(frequency_hz=200, operators=60), 1)


def test_a_voltage_that_the_drive_cuts_is_refused():
    with pytest.raises(IdentificationError, match="needs 11 V about 0 V, but the drive gives -10 to 10 V"):
        identified(_plant("duo_bimorph"), ClosedFormSpec(amplitude_v=11), 1)


@pytest.mark.full
def test_a_delay_is_not_taken_for_hysteresis_between_coarse_thresholds():
    plant = _plant("duo_bimorph_dense")
    thresholds = 0.18 + 9.7 * np.arange(28) / 28  # nothing moves within the first of them
    block = with_thresholds(plant.model.hysteresis, thresholds, 10.0)
    dead = Plant(replace(plant.model, hysteresis=block), plant.instruments)
    model = identified(dead, JOINT.model_copy(update={"operators": 20}), 1)
    assert model.dynamics.input_delay_s == 0.0
    for found, true in zip(model.dynamics.axes, plant.model.dynamics.axes, strict=True):
        assert found.resonance_hz == pytest.approx(true.resonance_hz, rel=3e-3)


def test_the_loop_is_taken_when_it_has_settled(monkeypatch):
    """The resonance of 280 Hz and damping 0.12 rings by exp(-211 t); the experiment waits 50 ms at least."""
    plant, taken = _plant("duo_bimorph", instruments=Instruments.ideal()), []

    def kept(u_v, y_um, operators):
        taken.append(y_um)
        return closed_form(u_v, y_um, operators)

    monkeypatch.setattr("hammerstein.experiment.simulated_identification.closed_form", kept)
    monkeypatch.setenv("HAMMERSTEIN_CACHE", "")
    identified(plant, ClosedFormSpec(frequency_hz=200, settle_cycles=1, measured_cycles=1), 1)
    voltage = np.zeros((2, 6000))
    voltage[0] = 10.0 * np.sin(2.0 * np.pi * 200.0 * T * np.arange(6000))
    last_cycle = plant.respond(voltage, 1).position_um[:, -100:]
    np.testing.assert_allclose(taken[0], last_cycle, atol=1e-3 * np.ptp(last_cycle[0]))


def test_every_input_is_driven_with_the_full_amplitude(monkeypatch):
    """Sines of 10 V, then a multisine whose peaks come near them."""
    seen = []

    def kept(records, *_, **__):
        seen.extend(records)
        raise IdentificationError("enough")

    monkeypatch.setattr("hammerstein.identification.identify.identify", kept)
    monkeypatch.setenv("HAMMERSTEIN_CACHE", "")
    with pytest.raises(IdentificationError, match="enough"):
        identified(_plant("duo_bimorph", instruments=Instruments.ideal()), JOINT, 1)
    assert len(seen) == 2
    for k, record in enumerate(seen):
        sine, noise = np.split(record.u_v[k][20:], 2)
        assert np.abs(sine).max() == pytest.approx(10.0, rel=1e-3)
        assert 6.0 < np.abs(noise).max() <= 10.0
        assert not record.u_v[1 - k].any()


OPTIONS = {
    "operators": "auto",
    "partition": "voltage",
    "hysteresis": "asymmetric",
    "dead_zones": 3,
    "dynamics": "lag",
    "creep_modes": 2,
}


@pytest.mark.parametrize(("name", "value"), OPTIONS.items())
def test_an_option_of_identify_means_the_same_in_a_scenario(name, value):
    given = {name: value} | ({"hysteresis": "asymmetric"} if name == "dead_zones" else {})
    settings = JointFitSpec.model_validate({"method": "hammerstein"} | given).settings()
    assert getattr(settings, name) == value == getattr(Settings(**given), name)


def test_every_word_of_identify_is_one_of_a_scenario_and_of_the_command_line():
    for name, words in (("partition", Partition), ("dynamics", DynamicsKind)):
        for word in get_args(words):
            operators = {"operators": 5} if word == "state_space" else {}
            JointFitSpec.model_validate({"method": "hammerstein", name: word} | operators)
    shared = set(OPTIONS) - {"hysteresis", "dead_zones"}  # which are those of one command alone
    assert shared <= CascadeOptions.model_fields.keys()


def test_a_scenario_takes_a_number_of_operators_for_each_pair():
    spec = JointFitSpec(method="hammerstein", operators=[[6, 8], [7, 6]], dynamics="none")
    model = identified(_plant("duo_bimorph_static", instruments=Instruments.ideal()), spec, 1)
    assert model.hysteresis.operators == ((6, 8), (7, 6))
    assert model.name == "joint fit, operators of each pair"


def test_what_does_not_go_together_is_refused_in_a_scenario_too():
    wrong = {"method": "hammerstein", "dead_zones": 3}
    scenario = {
        "question": "Which options?",
        "reference": {"kind": "circle", "radius_um": 5.0, "frequency_hz": 50.0},
        "compensators": [{"label": "a", "law": "exact_inverse", "identification": wrong}],
    }
    with pytest.raises(InputError, match=r"\[1\].identification.*dead_zones belongs to hysteresis"):
        run(scenario)


def test_another_linear_block_is_identified_for_a_scenario():
    none = JointFitSpec(method="hammerstein", operators=6, dynamics="none")
    assert isinstance(identified(_plant("duo_bimorph"), none, 1).dynamics, StaticDynamics)


@pytest.mark.full
def test_a_linear_block_with_creep_is_chosen_for_a_scenario():
    creep = {"creep_modes": 1, "creep_record_s": 60.0}
    model = identified(
        _plant("duo_bimorph_creep"), JointFitSpec(method="hammerstein", dynamics="auto", **creep), 1
    )
    assert all(axis.creep for axis in model.dynamics.axes)
