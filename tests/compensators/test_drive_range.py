"""Ranges from low to high, starts away from rest: every law against plays in a loop of the test's own."""

import itertools
import json
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import theory

from hammerstein.blocks import Law
from hammerstein.blocks.driving import DriveRange
from hammerstein.blocks.instruments import Drive, Instruments
from hammerstein.blocks.voltages import Verdict, Voltages
from hammerstein.commands.cli import main
from hammerstein.compensators.base import DecoupledInverseLaw, NoCompensationLaw
from hammerstein.compensators.drive_file import Terms
from hammerstein.compensators.exact.inverse import ExactInverseLaw
from hammerstein.compensators.inverse_multiplicative import InverseMultiplicativeLaw
from hammerstein.compensators.path_file import drive_csv
from hammerstein.compensators.preview.hammerstein_inverse import HammersteinInverseLaw
from hammerstein.compensators.reach import reach
from hammerstein.dynamics import AxesDynamics, Axis, StaticDynamics, discretise
from hammerstein.errors import InputError
from hammerstein.hysteresis import Pair, PrandtlIshlinskii
from hammerstein.model import HammersteinModel
from hammerstein.model.simulation import Plant

T = 50e-6
R = np.array([0.5, 3.0, 8.0, 20.0, 35.0])
W = np.array(
    [
        [[0.4, 0.05, 0.04, 0.03, 0.02], [0.03, 0.01, 0.0, 0.01, 0.0]],
        [[0.02, 0.0, 0.01, 0.0, 0.01], [0.3, 0.03, 0.05, 0.02, 0.01]],
    ]
)
REST = np.array([0.0, -20.0])
LAWS = {
    "none": lambda model, limits: NoCompensationLaw(model, limits),
    "inverse_multiplicative": lambda model, limits: InverseMultiplicativeLaw(model, limits, T, iterations=40),
    "decoupled_inverse": lambda model, limits: DecoupledInverseLaw(model, limits),
    "exact_inverse": lambda model, limits: ExactInverseLaw(model, limits),
    "exact_inverse, softened": lambda model, limits: ExactInverseLaw(model, limits, softening_v=0.05),
    "hammerstein_inverse": lambda model, limits: HammersteinInverseLaw(model, limits, T),
}


def model_of(dynamics=None, rest=REST, instruments=None, verdict=None):
    voltages = Voltages.of(rest, [0.0, -20.0], [100.0, 120.0])
    return HammersteinModel(
        "stage",
        PrandtlIshlinskii.from_arrays(R, W),
        dynamics or StaticDynamics(n_outputs=2),
        70.0,
        ("u", "v"),
        ("x", "y"),
        instruments=instruments or Instruments.ideal(T),
        voltages=voltages,
        verdict=verdict,
    )


def played(u_v, rest=REST):
    """Outputs (output, sample) of plays that rest at given voltages, in absolute volts."""
    plays = np.repeat(np.array(rest, dtype=float)[:, None], len(R), axis=1)
    out = np.empty((2, u_v.shape[1]))
    for t, u in enumerate(u_v.T):
        for k in range(2):
            plays[k] = np.maximum(u[k] - R, np.minimum(u[k] + R, plays[k]))
        out[:, t] = np.einsum("oki,ki->o", W, plays - np.array(rest)[:, None])
    return out


def wave(size, samples=1200):
    t = np.arange(samples) / samples
    x = np.minimum(3.0 * t, 1.0)
    grow = x**3 * (10.0 + x * (6.0 * x - 15.0))
    return np.stack([size * grow * np.sin(14.0 * t), 0.7 * size * grow * np.sin(9.0 * t + 0.2)])


@pytest.mark.parametrize("conditioned", [False, True])
@pytest.mark.parametrize("name", ["exact_inverse", "hammerstein_inverse"])
def test_the_inverse_is_exact_from_any_start(name, conditioned):
    """Residual at rounding, the path counted from where the actuator stands, the drive within its range."""
    limits = DriveRange.of([(0.0, 100.0), (-20.0, 120.0)], model_of(), [40.0, 55.0], conditioned)
    law, path = LAWS[name](model_of(), limits), wave(9.0)
    path -= path[:, :1]
    drive = law.drive_for(path)
    before = [[100.0, 120.0], [0.0, -20.0], [40.0, 55.0]] if conditioned else [[40.0, 55.0]]
    output = played(np.hstack([np.array(before).T, drive]))
    begin = output[:, len(before) - 1 : len(before)]
    np.testing.assert_allclose(output[:, len(before) :] - begin, path, atol=1e-11)
    assert (drive >= limits.low_v[:, None]).all()
    assert (drive <= limits.high_v[:, None]).all()


def test_a_model_with_dynamics_starts_where_it_stands():
    pair = (Axis(resonance_hz=280.0, damping_ratio=0.1), Axis(resonance_hz=350.0, damping_ratio=0.05))
    axes = AxesDynamics(axes=pair)
    limits = DriveRange.of([(0.0, 100.0), (-20.0, 120.0)], model_of(axes), [40.0, 55.0])
    path = wave(9.0)
    drive = HammersteinInverseLaw(model_of(axes), limits, T).drive_for(path)
    output = played(np.hstack([[[40.0], [55.0]], drive]))
    position, _ = discretise(axes, T).respond(output[:, 1:] - output[:, :1])
    assert np.abs(position - path)[:, 5:-5].max() < 1e-6
    np.testing.assert_allclose(drive[:, 0], [40.0, 55.0], atol=1.0)


@pytest.mark.parametrize("name", list(LAWS))
def test_every_law_begins_at_its_start_and_steps_as_it_responds(name):
    limits = DriveRange.of([(0.0, 60.0), (-20.0, 70.0)], model_of(), [40.0, 55.0])
    law: Law = LAWS[name](model_of(), limits)
    still, _ = law.respond(np.zeros((2, 5)))
    np.testing.assert_allclose(still, np.repeat([[40.0], [55.0]], 5, axis=1), atol=1e-9)
    path = wave(60.0, 300)  # leaves the range on both sides
    whole, _ = law.respond(path)
    assert (whole >= limits.low_v[:, None]).all()
    assert (whole <= limits.high_v[:, None]).all()
    assert (whole.max(axis=1) == limits.high_v).all()
    assert (whole.min(axis=1) == limits.low_v).all()
    now, steps = law.rest(), []
    for column in path.T:
        now = law.restore(json.loads(json.dumps(now.as_dict())))
        drive, now = law.step(column, now)
        steps.append(drive)
    np.testing.assert_array_equal(np.array(steps).T, whole)


@pytest.mark.parametrize("conditioned", [False, True])
@pytest.mark.parametrize("rest", [REST, np.array([50.0, 60.0])])
@pytest.mark.parametrize("name", list(LAWS))
def test_every_law_stands_still_whichever_way_its_start_was_reached(name, rest, conditioned):
    """From below or above, and on either side of the working point: nothing asks for a jump."""
    start = [40.0, 55.0]
    limits = DriveRange.of([(0.0, 60.0), (-20.0, 70.0)], model_of(rest=rest), start, conditioned)
    still, _ = LAWS[name](model_of(rest=rest), limits).respond(np.zeros((2, 3)))
    np.testing.assert_allclose(still, np.repeat(np.array(start)[:, None], 3, axis=1), atol=1e-9)


def test_after_the_range_cut_the_memory_is_still_that_of_the_actuator():
    """What an input at an end of its range cannot do is missed; afterwards the path is met again exactly."""
    for rest in (REST, np.array([100.0, 120.0])):
        limits = DriveRange.of([(0.0, 100.0), (-20.0, 120.0)], model_of(rest=rest))
        law, path = ExactInverseLaw(model_of(rest=rest), limits), wave(55.0, 3000)
        drive = law.drive_for(path)
        left = np.abs(played(drive, rest) - path)
        cut = limits.reached(drive).any(axis=0)
        assert cut.any()
        assert not cut.all()
        free = ~cut & (drive != np.roll(drive, 1, axis=1)).all(axis=0)
        assert left[:, free].max() < 1e-10


def test_reach_is_the_loop_between_the_ends():
    """One axis at rest at 0 V, 0 to 100 V: from the lower tip sum w r to the upper tip sum w (100 - r)."""
    w = W[0, 0]
    model = HammersteinModel(
        "one", PrandtlIshlinskii([[Pair(R, w)]]), StaticDynamics(n_outputs=1), 50.0, ("u",), ("x",)
    )
    tips = np.array([w @ R, w @ (100.0 - R)])
    np.testing.assert_allclose(reach(model, (0.0, 100.0)).alone_um, [tips], rtol=1e-9)
    begun = DriveRange.of((0.0, 100.0), model, [30.0])
    start = w @ np.maximum(30.0 - R, 0.0)
    np.testing.assert_allclose(reach(model, begun).alone_um, [tips - start], rtol=1e-9)
    cycled = DriveRange.of((0.0, 100.0), model, [30.0], conditioned=True)
    start = w @ [theory.play([100.0, 0.0, 30.0], r)[-1] for r in R]
    np.testing.assert_allclose(reach(model, cycled).alone_um, [tips - start], rtol=1e-9)


def test_ranges_of_a_drive():
    drive = Drive(range_v=[[0.0, 1.0], [-0.4, 2.2]], resolution_v=0.25)
    held, cut = drive.apply(np.array([[-1.0, 0.6, 1.01], [-0.4, -0.39, 9.0]]))
    np.testing.assert_array_equal(held, [[0.0, 0.5, 1.0], [-0.25, -0.25, 2.0]])  # no step beyond the range
    np.testing.assert_array_equal(cut, [[True, False, True], [False, False, True]])
    assert Drive(range_v=7).range_v == (-7.0, 7.0)
    assert Drive.model_validate_json('{"range_v": "Infinity"}').range_v == (-np.inf, np.inf)
    with pytest.raises(InputError, match="names 2 inputs; the actuator has 3"):
        drive.limits(3)
    for wrong in ([1.0, 0.0], [1.0, 2.0, 3.0], "ten", -1.0, True, [], [0.0, float("nan")]):
        with pytest.raises(InputError, match=r"low below high|must be -1e6 to 1e6"):
            Drive(range_v=wrong)


def call(*arguments):
    with pytest.raises(SystemExit) as caught:
        main([str(a) for a in arguments])
    return caught.value.code or 0


@pytest.fixture
def stage(tmp_path):
    model_of().save(tmp_path / "stage.json")
    t = T * np.arange(2000)
    smooth = np.sin(0.5 * np.pi * np.minimum(t / 0.05, 1.0)) ** 2
    frame = pd.DataFrame({"time_s": t, "x": 6.0 * smooth, "y": 5.0 * smooth})
    frame.to_csv(tmp_path / "path.csv", index=False)
    return tmp_path


def compensate(stage, *options, path="path.csv", model="stage.json"):
    return call("compensate", stage / model, stage / path, "--out", stage / "drive.csv", *options)


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        (
            ("--range", "100"),
            2,
            "-100 to 100 V, but u was recorded on one side only, from 0 to 100 V; give LOW,HIGH",
        ),
        (("--range", "5,5"), 2, "each LOW below its HIGH"),
        (("--range", "0,1,2"), 2, "one pair for each input"),
        (("--range", "a,b"), 2, "not a list of numbers"),
        (("--start", "40,50,60"), 2, "names 3 voltages; the model has 2 inputs"),
        (("--start", "-30"), 2, "is outside the range 0 to 100 V"),
        (("--start", "110", "--range", "0,130"), 3, "100 V; 2000 of 2000 samples are outside"),
    ],
)
def test_what_is_refused(stage, capsys, options, code, message):
    assert compensate(stage, "--law", "exact_inverse", *options) == code
    assert message in capsys.readouterr().err
    assert not (stage / "drive.csv").exists()


def test_beyond_the_records_only_when_asked(stage, capsys):
    options = ("--law", "exact_inverse", "--start", "110", "--range", "-50,130")
    assert compensate(stage, *options) == 3
    assert "--beyond-records" in capsys.readouterr().err
    assert compensate(stage, *options, "--beyond-records") == 0


def test_axes_are_told_by_their_names_in_any_order():
    """A path that needs more volts than there are of u alone."""
    told = []
    for order in ([0, 1], [1, 0]):
        model = model_of(rest=np.zeros(2))
        pairs = [[model.hysteresis.pairs[o][k] for k in order] for o in order]
        names = [[names[k] for k in order] for names in (model.inputs, model.outputs)]
        kept = {
            "voltages": Voltages.of([0.0, 0.0], [-50.0] * 2, [100.0] * 2),
            "instruments": model.instruments,
        }
        turned = HammersteinModel("stage", PrandtlIshlinskii(pairs), model.dynamics, 70.0, *names, **kept)
        found = turned.compensate(wave(40.0)[order], law="exact_inverse", clip=True).summary()
        told.append(json.loads(json.dumps(found), parse_float=lambda text: float(f"{float(text):.6g}")))
    for key in ("axes", "inputs", "unreached_samples"):
        assert told[1][key] == told[0][key]
    assert told[0]["unreached_samples"]["u"] > 0
    said = " ".join(told[0]["statements"])
    assert "input u is at its lower limit, -50 V" in said
    assert "output x has an error of up to" in said


def test_out_of_reach_names_volts_and_positions(stage, capsys):
    frame = pd.read_csv(stage / "path.csv")
    frame["x"] *= -10.0
    frame.to_csv(stage / "below.csv", index=False)
    assert compensate(stage, "--law", "exact_inverse", path="below.csv") == 3
    error = capsys.readouterr().err
    assert re.search(r"u hits its lower limit, 0 V \(the path needs -[\d.]+ V at \S+ s\)", error)
    assert "0 to 100 V on u, -20 to 120 V on v (--range)" in error
    low, high = reach(model_of(), [(0.0, 100.0), (-20.0, 120.0)]).alone_um[0]
    assert f"with the others at mid-range: x {low:.4g} to {high:.4g}" in error


@pytest.mark.full
def test_a_corner_gets_a_filter_with_a_number(tmp_path, capsys):
    axes = AxesDynamics(axes=(Axis(resonance_hz=100.0, damping_ratio=0.02),) * 2)
    model_of(axes).save(tmp_path / "stage.json")
    t = T * np.arange(8000)
    triangle = 40.0 * np.abs((20.0 * t + 0.5) % 1.0 - 0.5)
    pd.DataFrame({"time_s": t, "x": triangle, "y": triangle}).to_csv(tmp_path / "path.csv", index=False)
    command = (tmp_path, "--start", "45,45")
    assert compensate(*command) == 3
    error = capsys.readouterr().err
    assert "--filter-hz " in error
    value = error.split("--filter-hz ")[1].split()[0]
    assert compensate(*command, "--filter-hz", value) == 0
    assert compensate(*command, "--filter-hz", 1.5 * float(value)) == 3  # no smaller than needed


def test_a_flagged_model_needs_a_word(stage, capsys):
    flags = ("x saturates: its branches flatten",)
    model_of(verdict=Verdict(flagged=True, statements=flags, held_out=True)).save(stage / "flagged.json")
    model_of(verdict=Verdict(flagged=False)).save(stage / "untested.json")
    law = ("--law", "exact_inverse")
    assert compensate(stage, *law, model="flagged.json") == 4
    assert "x saturates: its branches flatten" in capsys.readouterr().err
    assert not (stage / "drive.csv").exists()
    assert compensate(stage, *law, "--accept-flagged", model="flagged.json") == 0
    head = [line for line in (stage / "drive.csv").read_text().splitlines() if line.startswith("#")]
    assert any("FLAGGED" in line and flags[0] in line for line in head)
    assert compensate(stage, *law, model="untested.json") == 0
    assert "no validation record" in (stage / "drive.csv").read_text()


def test_the_drive_file_is_read_by_pandas_and_by_us(stage):
    from hammerstein.records.reading import read_records
    from hammerstein.signals.signal_files import read_signal

    assert compensate(stage, "--law", "exact_inverse") == 0
    out = stage / "drive.csv"
    table = pd.read_csv(out, comment="#")
    plain = np.genfromtxt(out, delimiter=",", names=True)
    assert plain.dtype.names == tuple(table.columns)
    same = {"rtol": 1e-12, "atol": 1e-14}  # older pandas is off in the last bit
    np.testing.assert_allclose(plain["drive_u_v"], table["drive_u_v"], **same)
    _, values, names = read_signal(out)
    np.testing.assert_allclose(values, table.drop(columns="time_s").to_numpy().T, **same)
    assert names[:2] == ["drive_u_v", "drive_v_v"]
    columns = {"inputs": ["drive_u_v", "drive_v_v"], "outputs": ["predicted_x_um", "predicted_y_um"]}
    (record,) = read_records([out], time="time_s", **columns)
    np.testing.assert_allclose(record.u_v, values[:2], **same)
    assert record.sample_time_s == pytest.approx(T)
    text = out.read_text()
    assert "u from 0 to 100 V, at rest at 0 V; v from -20 to 120 V, at rest at -20 V" in text
    assert "Initial state, where the path is zero: 0 V on u, -20 V on v" in text


def test_twins_of_a_name_keep_their_columns(stage):
    content = json.loads((stage / "stage.json").read_text()) | {"inputs": ["Volt", "Volt"]}
    (stage / "twins.json").write_text(json.dumps(content))
    assert HammersteinModel.load(stage / "twins.json").inputs == ("Volt", "Volt_2")
    assert compensate(stage, "--law", "exact_inverse", model="twins.json") == 0
    table = pd.read_csv(stage / "drive.csv", comment="#")
    assert list(table.columns[:3]) == ["time_s", "drive_Volt_v", "drive_Volt_2_v"]


@pytest.mark.full
def test_scenario_about_a_working_point(tmp_path):
    """The same experiment at another working point: the same positions, voltages moved by it."""
    import hammerstein

    found = []
    for rest in (np.zeros(2), np.array([30.0, -70.0])):
        ends = [[-50.0 + u, 50.0 + u] for u in rest.tolist()]
        drive = Drive(range_v=ends, resolution_v=0.0)
        model = HammersteinModel(
            "stage",
            PrandtlIshlinskii.from_arrays(R, W),
            AxesDynamics(axes=(Axis(resonance_hz=280.0, damping_ratio=0.1),) * 2),
            50.0,
            ("u", "v"),
            ("x", "y"),
            instruments=Instruments(drive=drive),
            voltages=Voltages.of(rest, np.array(ends)[:, 0], np.array(ends)[:, 1]),
        )
        model.save(tmp_path / "stage.json")
        (tmp_path / "s.toml").write_text(
            'question = "?"\nactuator = "stage.json"\n[reference]\nkind = "circle"\nradius_um = 10\n'
            "frequency_hz = 50\noffset_um = [2, 3]\nsmooth_start_s = 0.02\n"
            + "".join(
                f'[[compensators]]\nlabel = "{law}"\nlaw = "{law}"\n'
                'identification = { method = "hammerstein", operators = 8, record_s = 0.02 }\n'
                for law in (*LAWS, "feedback")
                if "," not in law
            )
        )
        scenario = hammerstein.load_scenario(tmp_path / "s.toml")
        laws = [c.label for c in scenario.compensators]
        found.append([hammerstein.simulate(scenario, law) for law in laws])
    for here, there in zip(*found, strict=True):
        np.testing.assert_allclose(there.drive_v, here.drive_v + np.array([[30.0], [-70.0]]), atol=1e-5)
        np.testing.assert_allclose(there.position_um, here.position_um, atol=1e-5)
        middle = 0.5 * (here.reference_um.max(axis=1) + here.reference_um.min(axis=1))
        np.testing.assert_allclose(middle, [2.0, 3.0], atol=0.05)


@pytest.mark.parametrize(
    "kind", ["sine", "triangle", "degauss", "circle", "spiral", "lissajous", "multisine", "file"]
)
def test_every_reference_takes_an_offset(tmp_path, kind):
    from pydantic import TypeAdapter

    from hammerstein.signals import Reference

    (tmp_path / "p.csv").write_text("time_s,x,y\n0,1,3\n1,2,4\n")
    own = {
        "sine": {"amplitude_um": 5.0, "frequency_hz": 2.0, "axis": 1},
        "triangle": {"amplitude_um": 5.0, "frequency_hz": 2.0, "axis": "all"},
        "degauss": {"amplitude_um": 5.0, "frequency_hz": 2.0, "cycles": 2},
        "circle": {"radius_um": 5.0, "frequency_hz": 2.0},
        "spiral": {"radius_um": 5.0, "frequency_hz": 2.0, "trigger_s": 0.1, "decay_s": 0.2},
        "lissajous": {"amplitude_um": 5.0, "frequency_x_hz": 2.0, "frequency_y_hz": 3.0},
        "multisine": {"amplitude_um": 5.0, "lowest_hz": 1.0, "highest_hz": 9.0},
        "file": {"path": str(tmp_path / "p.csv")},
    }[kind]
    time_s = np.linspace(0.0, 1.0, 50)
    plain, moved = (
        TypeAdapter(Reference).validate_python({"kind": kind, **own, **more}).sample(time_s, 2)
        for more in ({}, {"offset_um": (7.0, -3.0)})
    )
    np.testing.assert_allclose(moved, plain + np.array([[7.0], [-3.0]]), atol=1e-12)


def test_a_drive_scenario_lies_about_the_working_point():
    """Simulated, the voltages are absolute, what is not driven rests, and the positions count from there."""
    import hammerstein
    from hammerstein.experiment.set_up import set_up

    model = model_of(rest=[40.0, 55.0])
    content = {
        "question": "?",
        "actuator": "duo_bimorph",
        "drive": {"kind": "sine", "amplitude_v": 20.0, "frequency_hz": 50.0},
    }
    setup = set_up(hammerstein.Scenario.model_validate(content))
    setup = replace(setup, plant=Plant(model, model.instruments))  # in place of the packaged one
    run = setup.simulate(next(setup.cases()))
    time_s = T * np.arange(run.drive_v.shape[1])
    expected = np.stack([40.0 + 20.0 * np.sin(2.0 * np.pi * 50.0 * time_s), np.full(len(time_s), 55.0)])
    np.testing.assert_allclose(run.drive_v, expected, atol=1e-9)
    np.testing.assert_allclose(run.position_um, played(expected, [40.0, 55.0]), atol=1e-9)


def test_a_drive_without_offset_lies_about_the_working_point():
    from pydantic import TypeAdapter

    from hammerstein.signals import Excitation

    sine = {"kind": "sine", "amplitude_v": 5.0, "frequency_hz": 2.0, "axis": 1, "smooth_start_s": 0.5}
    time_s, rest = np.linspace(0.0, 1.0, 50), np.array([30.0, -70.0])
    here = TypeAdapter(Excitation).validate_python(sine).sample(time_s, 2, rest)
    np.testing.assert_allclose(here[1], -70.0)
    wave = 5.0 * np.sin(4 * np.pi * time_s[time_s > 0.5])
    np.testing.assert_allclose(here[0, time_s > 0.5], 30.0 + wave)
    absolute = TypeAdapter(Excitation).validate_python(sine | {"offset_v": 0.0}).sample(time_s, 2, rest)
    assert absolute[0, 0] == 30.0  # it grows from where the actuator rests
    np.testing.assert_allclose(
        absolute[0, time_s > 0.5], 5.0 * np.sin(4 * np.pi * time_s[time_s > 0.5]), atol=1e-9
    )


def test_the_input_whose_range_is_too_wide_is_named():
    model = model_of()
    drive = model.instruments.drive.model_copy(update={"range_v": ((0.0, 100.0), (-30.0, 130.0))})
    narrow = replace(model, instruments=model.instruments.model_copy(update={"drive": drive}))
    with pytest.raises(InputError, match=r"-20 to 150 V exceeds the range of v in .*, -30 to 130 V"):
        Terms(range_v=(0.0, 100.0, -20.0, 150.0)).allowed_range(narrow)


def test_a_model_far_from_home_says_so():
    import hammerstein

    content = {
        "question": "?",
        "actuator": "duo_bimorph_static",
        "drive": {"kind": "sine", "amplitude_v": 9.0, "frequency_hz": 50.0},
    }
    reports = []
    for amplitude in (None, 5.0, 8.75, 8.5):
        given = {} if amplitude is None else {"amplitude_v": amplitude}
        models = [{"label": "m", "identification": {"method": "closed_form", **given}}]
        reports.append(hammerstein.run(hammerstein.Scenario.model_validate(content | {"models": models})))
    assert not any("identified from" in text for text in reports[0].statements)
    (said,) = [text for text in reports[1].statements if "identified from" in text]
    assert "but the model was identified from -5 to 5 V" in said
    told = [any("identified from" in text for text in report.statements) for report in reports[2:]]
    assert told == [False, True]  # 1.4 and 2.9 % of the recorded range beyond it


def test_signs_of_poling():
    cases = {(0.0, 150.0): "positive", (-30.0, 150.0): "positive", (-150.0, 0.0): "negative"}
    cases |= {
        (-150.0, 37.0): "negative",
        (-50.0, 50.0): "both",
        (-60.0, 150.0): "both",
        (35.0, 90.0): "positive",
    }
    for (low, high), sign in cases.items():
        assert Voltages.of([low], [low], [high]).poling == (sign,)
    for low, high in itertools.product((1.0, 2.0), (1.0,)):
        with pytest.raises(InputError, match="must lie below"):
            Voltages.of([0.0], [low], [high])


def test_a_drive_file_with_columns_of_other_axes_is_never_written():
    from hammerstein.compensators.path_file import drive_csv

    rows = np.zeros((2, 3))
    with pytest.raises(InputError, match="two columns would have the name drive_u_v"):
        drive_csv(np.zeros(3), [("drive", "v", ["u", "u#"], rows)], [])
    with pytest.raises(InputError, match="2 drive columns for 1 names"):
        drive_csv(np.zeros(3), [("drive", "v", ["u"], rows)], [])


def test_a_first_sample_far_from_the_start_is_named_with_its_remedy():
    """The path begins 20 um away: the first voltage, by theory, is a large part of the range."""
    path = 20.0 + wave(5.0)
    said = model_of().compensate(path, law="exact_inverse", range_v=[0.0, 100.0, -20.0, 120.0])
    steps = np.abs(said.drive_v[:, 0] - said.law.range.start_v)
    named = [text for text in said.statements() if "--lead-in leads there" in text]
    assert len(named) == int((steps > 0.1 * said.law.range.span_v).sum()) > 0
    assert f"{steps[0]:.3g} V from the start" in named[0]


def test_times_of_a_drive_file_have_no_digits_of_rounding(tmp_path):
    time_s = np.arange(2000) * 1e-4
    place = tmp_path / "drive.csv"
    place.write_text(drive_csv(time_s, [("drive", "v", ["x"], np.zeros((1, 2000)))], []))
    words = [row.split(",")[0] for row in place.read_text().splitlines()[1:]]
    assert max(map(len, words)) <= len("0.1999")
    assert np.array(words, dtype=float) == pytest.approx(time_s, abs=1e-15)
