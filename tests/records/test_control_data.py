"""Linear systems and time responses of python-control, in both directions."""

import control
import matplotlib as mpl
import numpy as np
import pytest

import hammerstein
from hammerstein.blocks.instruments import Instruments
from hammerstein.dynamics import StateSpaceDynamics, discretise
from hammerstein.errors import InputError
from hammerstein.model import HammersteinModel
from hammerstein.model.simulation import Plant
from hammerstein.records.record import Record

T = 1e-3
FREQUENCY_HZ = np.array([1.0, 20.0, 133.0, 400.0])


def _tf(*rows):
    return control.combine_tf([[control.tf(*element, 0) for element in row] for row in rows])


CONTINUOUS = control.tf([3.0, 400.0], [1e-3, 2.0, 500.0])
SYSTEMS = {
    "continuous": CONTINUOUS,
    "zeros and poles": control.zpk([-5.0], [-20.0, -300.0], 7.0),
    "proportional": control.tf([4.0], [2.0]),
    "as proper as can be": control.tf([2.0, 1.0, 3.0], [1.0, 5.0, 8.0]),
    "many axes": _tf([([1.0], [0.01, 1.0]), ([0.2], [1.0])], [([0.0], [1.0]), ([2.0], [1e-4, 1e-2, 1.0])]),
    "wide": _tf([([1.0], [0.01, 1.0]), ([2.0], [0.03, 1.0]), ([5.0], [1.0])]),
    "state space": control.ss([[0.0, 50.0], [-50.0, -6.0]], [[0.0], [50.0]], [[1.0, 0.0]], [[0.5]]),
}


@pytest.mark.parametrize("system", SYSTEMS.values(), ids=SYSTEMS)
def test_a_linear_block_responds_as_the_system_it_comes_from(system):
    """Continuous systems by their own frequency response, and by python-control's hold on the grid."""
    dynamics = StateSpaceDynamics.of(system)
    assert dynamics.sample_time_s is None
    s = 2j * np.pi * FREQUENCY_HZ
    p, m = system.noutputs, system.ninputs
    expected = np.reshape(system(s, squeeze=False), (p, m, -1))
    np.testing.assert_allclose(dynamics.system()(s, squeeze=False), expected, rtol=1e-9, atol=1e-12)
    block = discretise(dynamics, T)
    u = np.random.default_rng(1).normal(size=(m, 50))
    held = control.c2d(dynamics.system(), T, "zoh")
    wanted = control.forced_response(held, T * np.arange(50), u, squeeze=False).outputs.reshape(p, 50)
    np.testing.assert_allclose(block.respond(u)[0], wanted, rtol=1e-9, atol=1e-12)


def test_a_discrete_transfer_function_keeps_its_grid():
    system = control.tf([0.2, 0.1], [1.0, -0.9, 0.2], T)
    dynamics = StateSpaceDynamics.of(system, input_delay_s=2 * T)
    assert dynamics.sample_time_s == T
    found, _ = discretise(dynamics, T).respond([[1.0] + [0.0] * 9])
    impulse = [0.0, 0.2, 0.1 + 0.9 * 0.2]
    impulse += [0.9 * impulse[2] - 0.2 * impulse[1]]
    np.testing.assert_allclose(found[0, 2:6], impulse, atol=1e-14)


@pytest.mark.parametrize(
    ("system", "message"),
    [
        (control.frd([1.0, 0.5], [1.0, 10.0]), "a frequency response, which has no state; first fit"),
        (control.tf([1.0, 0.0, 0.0], [1.0, 1.0]), "improper"),
        (control.tf([1.0], [1.0, 0.5], True), "discrete without a sample time"),
        (control.saturation_nonlinearity(1.0), "is a saturation_nonlinearity; give a control.StateSpace"),
    ],
)
def test_what_no_linear_block_can_be_is_refused(system, message):
    with pytest.raises(InputError, match=message):
        StateSpaceDynamics.of(system)


@pytest.fixture(scope="module")
def response():
    model = HammersteinModel.load("duo_bimorph")
    time = 50e-6 * np.arange(1200)
    u = np.stack([6.0 * np.sin(700.0 * time), 3.0 * np.sin(400.0 * time)])
    return Plant(model, model.instruments).respond(u, [2])


def test_a_response_is_a_time_response(response):
    data = response.to_time_response(("position_um", "reading_um"))
    assert data.output_labels == [f"{wire}[{i}]" for wire in ("position_um", "reading_um") for i in (0, 1)]
    assert data.input_labels == ["drive_v[0]", "drive_v[1]"]
    assert (data.outputs["reading_um[1]"] == response.reading_um[1]).all()
    assert (data.time == response.time_s).all()
    table = data.to_pandas()
    assert (table["position_um[0]"].to_numpy() == response.position_um[0]).all()


def test_a_time_response_is_plotted_without_a_warning(response):
    import matplotlib.pyplot as plt

    mpl.use("Agg")
    try:
        lines = response.to_time_response().plot().lines
        assert (lines.ravel()[0][0].get_ydata() == response.position_um[0]).all()
    finally:
        plt.close("all")


def test_with_a_reference_that_is_the_input():
    scenario = {
        "question": "What is asked?",
        "actuator": "duo_bimorph_static",
        "reference": {"kind": "sine", "amplitude_um": 20.0, "frequency_hz": 50.0},
        "compensators": [{"label": "none", "law": "none", "model": "duo_bimorph_static"}],
        "measure": {"settle_cycles": 0, "measured_cycles": 1},
    }
    response = hammerstein.simulate(scenario)
    data = response.to_time_response()
    assert data.input_labels == ["reference_um[0]", "reference_um[1]"]
    driven = response.to_time_response(("drive_v",), ("requested_v",))
    assert (driven.outputs == response.drive_v).all()
    assert (driven.inputs == response.requested_v).all()


def test_a_wire_that_a_run_does_not_have_is_refused(response):
    with pytest.raises(InputError, match="'reference_um' is not a signal of this run; it has requested_v"):
        response.to_time_response(inputs=("reference_um",))


def test_records_come_back_from_a_time_response(response):
    (record,) = hammerstein.records_of_time_response(response.to_time_response(("reading_um",)))
    assert (record.u_v == response.drive_v).all()
    assert (record.y_um == response.reading_um).all()
    assert record.sample_time_s == 50e-6
    assert record.inputs == ("drive_v[0]", "drive_v[1]")


def test_every_trace_is_a_record():
    """A step response of two inputs and outputs: python-control drives one input after the other."""
    slow, quick = (
        control.ss([[-1.0 / t]], [[g / t]], [[1.0]], [[0.0]]) for g, t in ((2.0, 0.02), (3.0, 0.01))
    )
    system = control.append(slow, quick) * control.ss([], [], [], [[1.0, 0.1], [0.2, 1.0]])
    data = control.step_response(system, np.linspace(0.0, 0.1, 101))
    data.u = data.u * np.linspace(0.0, 1.0, 101)  # a ramp: a step never moves
    records = hammerstein.records_of_time_response(data)
    assert [record.source for record in records] == ["time response, trace 1", "time response, trace 2"]
    assert (records[1].y_um == data.y[:, 1]).all()
    assert (records[0].u_v[1] == 0.0).all()


def test_signals_are_chosen_by_their_labels(response):
    data = response.to_time_response(("position_um", "reading_um"))
    (record,) = hammerstein.records_of_time_response(
        data, ["drive_v[1]"], ["reading_um[1]", "position_um[0]"]
    )
    assert isinstance(record, Record)
    assert (record.y_um[0] == response.reading_um[1]).all()
    with pytest.raises(InputError, match=r"has no output y; it has position_um\[0\]"):
        hammerstein.records_of_time_response(data, outputs=["y"])


def test_what_is_no_record_is_refused():
    time = np.array([0.0, 1.0, 2.0, 3.5, *range(5, 300)], dtype=float)
    data = control.TimeResponseData(time, np.sin(time), inputs=np.cos(time))
    with pytest.raises(InputError, match="time"):
        hammerstein.records_of_time_response(data)
    alone = control.TimeResponseData(T * np.arange(300), np.sin(np.arange(300.0)), issiso=True)
    with pytest.raises(InputError, match="holds no inputs"):
        hammerstein.records_of_time_response(alone)


def test_a_response_is_a_table(response):
    table = response.to_frame()
    assert table.index.name == "time_s"
    assert (table["reading_y_um"].to_numpy() == response.reading_um[1]).all()
    assert not any(name.startswith("reference") for name in table)
    nameless = Plant(HammersteinModel.load("duo_bimorph"), Instruments.ideal()).respond(np.zeros((2, 3)), [0])
    assert list(nameless.after(1).to_frame().index) == [0.0, 50e-6]
