"""Blocks as python-control systems: the numbers of ``simulate`` through ``control.interconnect``."""

import control
import numpy as np
import pytest

import hammerstein
from hammerstein.blocks.block_system import Packing
from hammerstein.blocks.instruments import Drive, Instruments, Sensor
from hammerstein.compensators.base import NoCompensationLaw
from hammerstein.compensators.exact.inverse import ExactInverseLaw
from hammerstein.compensators.feedback.pid import FeedbackController, FeedbackStream
from hammerstein.compensators.inverse_multiplicative import InverseMultiplicativeLaw
from hammerstein.compensators.preview.hammerstein_inverse import HammersteinInverseLaw
from hammerstein.errors import InputError
from hammerstein.experiment.set_up import set_up
from hammerstein.model import HammersteinModel

T = 50e-6
SAMPLES = 400
LAWS = {
    "none": {"law": "none"},
    "paper": {"law": "inverse_multiplicative"},
    "filter": {"law": "inverse_multiplicative", "filter_s": 1e-4},
    "decoupled": {"law": "decoupled_inverse"},
    "exact": {"law": "exact_inverse", "softening_v": 0.1},
    "dynamics": {"law": "hammerstein_inverse"},
    "known ahead": {"law": "hammerstein_inverse", "filter_hz": 1500.0},
    "known too little": {"law": "hammerstein_inverse", "filter_hz": 1500.0, "preview_s": 0.5e-3},
    "feedback": {"law": "feedback"},
    "both": {"law": "feedback", "feedforward": "hammerstein_inverse"},
    "both, static": {"law": "feedback", "feedforward": "exact_inverse"},
}
QUICK = {"none", "exact", "known ahead", "feedback"}


def _signals(wire, count=2):
    return [f"{wire}[{i}]" for i in range(count)]


def _set_up_with(options, model="duo_bimorph", seed=3):
    scenario = hammerstein.Scenario.model_validate(
        {
            "question": "Does python-control see the same?",
            "actuator": "duo_bimorph",
            "reference": {"kind": "circle", "radius_um": 25.0, "frequency_hz": 100.0},
            "measure": {"settle_cycles": 0, "settle_s": 0.0, "measured_cycles": 1},
            "compensators": [{"label": "law", "model": model} | options],
            "seed": seed,
        }
    )
    setup = set_up(scenario)
    (case,) = setup.cases()
    return setup, case, setup.laws["law"]


@pytest.mark.parametrize(
    "options",
    [
        pytest.param(options, id=name, marks=() if name in QUICK else pytest.mark.full)
        for name, options in LAWS.items()
    ],
)
def test_compensator_and_actuator_give_the_numbers_of_simulate(options):
    """Drive, sensor, noise and seed included; the reference is known ahead as far as the law looks."""
    setup, case, law = _set_up_with(options)
    expected = setup.simulate(case)
    stream = FeedbackStream(law) if isinstance(law, FeedbackController) else law
    samples, known = expected.reference_um.shape[1], expected.reference_um
    if stream is law:  # a circle that goes on; a feedforward beside feedback knows what the run knows
        angle = 2.0 * np.pi * 100.0 * T * np.arange(samples + law.preview_samples)
        known = 25.0 * np.stack([np.cos(angle), np.sin(angle)])
    state, coming = stream.primed(known)
    compensator = law.to_iosys(T)
    actuator = setup.plant.to_iosys(case.seed(3), outputs=("position_um", "reading_um"))
    loop = control.interconnect(
        [compensator, actuator],
        inputs=_signals("reference_um"),
        outputs=_signals("position_um") + _signals("reading_um"),
    )
    start = np.concatenate([compensator.state_vector(state), np.zeros(actuator.nstates)])
    found = control.input_output_response(loop, expected.time_s, coming[:, :samples], start).outputs
    np.testing.assert_allclose(found[:2], expected.position_um, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found[2:], expected.reading_um, rtol=0, atol=1e-9)
    assert np.abs(expected.position_um).max() > 5.0


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0)])
def test_from_rest_the_numbers_come_later_by_the_preview(order):
    """Nothing is told but the reference; a chain of three blocks in any order is exact."""
    model = HammersteinModel.load("duo_bimorph")
    law = HammersteinInverseLaw(model, 10.0, T, filter_hz=1500.0)
    time = T * np.arange(SAMPLES)
    window = np.clip((time - 6e-3) / 4e-3, 0.0, 1.0) ** 3
    reference = 20.0 * window * np.stack([np.sin(600.0 * time), np.cos(500.0 * time)])
    u = law.drive_for(reference)
    v, _ = model.hysteresis.respond(u)
    expected, _ = hammerstein.discretise(model.dynamics, T).respond(v)
    blocks = [
        law.to_iosys(T),
        model.hysteresis.to_iosys(T),
        hammerstein.discretise(model.dynamics, T).to_iosys(T),
    ]
    blocks[1].update_names(inputs=_signals("requested_v"))
    loop = control.interconnect(
        [blocks[i] for i in order], inputs=_signals("reference_um"), outputs=_signals("position_um")
    )
    found = control.input_output_response(loop, time, reference).outputs
    late = law.preview_samples
    assert late > 10
    np.testing.assert_allclose(found[:, late:], expected[:, :-late], rtol=0, atol=1e-9)
    assert (found[:, :late] == 0.0).all()


@pytest.mark.parametrize("name", ["asymmetric_stack", "rate_dependent_stack"])
def test_every_kind_of_hysteresis_is_a_system(name):
    block = HammersteinModel.load(name).hysteresis.on_grid(T)
    u = 8.0 * np.sin(np.arange(60) / 7.0 + np.array([[0.0], [1.0]]))
    found = control.input_output_response(block.to_iosys(T), T * np.arange(60), u).outputs
    np.testing.assert_array_equal(found, block.respond(u)[0])


def test_python_controls_own_state_space_stands_for_the_dynamics():
    model = HammersteinModel.load("duo_bimorph")
    u = 8.0 * np.random.default_rng(4).normal(size=(2, 100))
    found = control.input_output_response(model.to_iosys(T), T * np.arange(100), u).outputs
    v, _ = model.hysteresis.respond(u)
    block = control.c2d(model.dynamics.system(), T, "zoh")
    expected = control.forced_response(block, T * np.arange(100), v).outputs
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


def test_the_same_question_gets_the_same_reply():
    """python-control evaluates a sample several times, at wrong inputs too: nothing is moved by asking."""
    model = HammersteinModel.load("duo_bimorph")
    actuator = model.to_iosys(T, instruments=model.instruments, seed=1, outputs=("reading_um",))
    x = actuator.dynamics(0.0, np.zeros(actuator.nstates), [3.0, -2.0])
    first = actuator.output(0.0, x, [5.0, 1.0])
    for u in np.random.default_rng(0).normal(size=(9, 2)):
        actuator.output(0.0, x, u)
        actuator.dynamics(0.0, x, u)
    assert (actuator.output(0.0, x, [5.0, 1.0]) == first).all()
    assert (actuator.output(0.0, actuator.dynamics(0.0, x, [5.0, 1.0]), [5.0, 1.0]) != first).any()


def test_the_seed_moves_the_noise_alone():
    model = HammersteinModel.load("duo_bimorph")
    time, u = T * np.arange(60), np.full((2, 60), 4.0)
    outputs = ("position_um", "reading_um")
    a, b, c = (
        control.input_output_response(
            model.to_iosys(T, instruments=model.instruments, seed=seed, outputs=outputs), time, u
        ).outputs
        for seed in (1, 2, 1)
    )
    assert (a == c).all()
    assert (a[:2] == b[:2]).all()
    assert (a[2:] != b[2:]).any()


def test_effects_come_on_request():
    model = HammersteinModel.load("duo_bimorph_static")
    u = np.tile([[12.34567], [0.0]], (1, 3))
    drives = [
        control.input_output_response(
            model.to_iosys(T, instruments=i, outputs=("drive_v",)), T * np.arange(3), u
        )
        for i in (None, Instruments(drive=Drive(range_v=9.0, resolution_v=0.5), sensor=Sensor()))
    ]
    assert (drives[0].outputs == u).all()
    assert (drives[1].outputs[0] == 9.0).all()


def test_a_state_goes_to_a_vector_and_back():
    model = HammersteinModel.load("duo_bimorph")
    block = model.hysteresis
    system = block.to_iosys(T)
    _, state = block.respond(np.random.default_rng(2).uniform(-9.0, 9.0, (2, 50)))
    vector = system.state_vector(state)
    assert (system.state_vector(block.rest()) == 0.0).all()
    assert system.state_of(vector).as_dict() == state.as_dict()
    u = np.random.default_rng(3).uniform(-9.0, 9.0, (2, 40))
    found = control.input_output_response(system, T * np.arange(40), u, vector).outputs
    assert (found == block.respond(u, state)[0]).all()


def test_whole_numbers_of_128_bits_are_kept():
    like = {"name": "generator", "inner": {"whole": 5, "list": [1.0, 2.0]}, "none": []}
    packing = Packing(like)
    data = {
        "name": "generator",
        "inner": {"whole": 2**127 + 12345678901234567890, "list": [1.5, -2.0]},
        "none": [],
    }
    back = packing.unpack(packing.pack(data))
    assert back["inner"]["whole"] == data["inner"]["whole"]
    assert back["name"] == "generator"
    assert back["inner"]["list"].tolist() == [1.5, -2.0]
    assert packing.length == 6
    with pytest.raises(InputError, match="the number of values differs"):
        packing.pack({"name": "", "inner": {"whole": 1, "list": [1.0]}, "none": []})


def test_a_system_can_be_linearised():
    """Around rest only plays of threshold zero move: the gain is their weight."""
    block = hammerstein.PrandtlIshlinskii([[hammerstein.Pair([0.0, 1.0], [2.0, 3.0])]])
    system = block.to_iosys(T)
    linear = system.linearize(np.zeros(system.nstates), [0.0])
    assert linear.D[0, 0] == pytest.approx(2.0)


@pytest.mark.parametrize(
    "build",
    [
        lambda model: HammersteinInverseLaw(model, 10.0, T),
        lambda model: FeedbackController(model, 10.0, T),
        lambda model: InverseMultiplicativeLaw(model, 10.0, T, filter_s=1e-3),
        lambda model: hammerstein.discretise(model.dynamics, T),
    ],
)
def test_another_sample_time_is_refused(build):
    block = build(HammersteinModel.load("duo_bimorph"))
    with pytest.raises(InputError, match="was designed for 5e-05"):
        block.to_iosys(2 * T)


@pytest.mark.parametrize("build", [NoCompensationLaw, ExactInverseLaw])
def test_a_static_law_runs_on_any_grid(build):
    assert build(HammersteinModel.load("duo_bimorph"), 10.0).to_iosys(1e-3).dt == 1e-3


def test_what_is_no_wire_of_the_plant_is_refused():
    model = HammersteinModel.load("duo_bimorph")
    with pytest.raises(
        InputError, match="reference_um is not an output; give some of drive_v, hysteresis_um, position_um"
    ):
        model.to_iosys(T, outputs=("reference_um",))
    with pytest.raises(InputError, match="must be above 0"):
        model.to_iosys(0.0)
