"""Units in names and rows of units, names that stand twice, gains that no actuator has."""

from __future__ import annotations

import numpy as np
import pytest
from record_cases import TIME, N, U, X, message, read, table_text
from scipy.signal import lfilter

from hammerstein.commands.cli import main
from hammerstein.errors import InputError
from hammerstein.hysteresis import play
from hammerstein.records.gains import (
    Gain,
    doubtful_clocks,
    doubtful_gains,
    doubtful_jumps,
    doubtful_order,
    doubtful_responses,
    pair_gains,
)
from hammerstein.records.readers import read_columns
from hammerstein.records.reading import read_records
from hammerstein.records.record import Record


@pytest.mark.parametrize(
    ("header", "v_per", "um_per"),
    [
        ("t,u_mV,x_nm", 1e-3, 1e-3),
        ("t,u [kV],x (mm)", 1e3, 1e3),
        ("t [s],u / mV,x / m", 1e-3, 1e6),
        ("t,u,x\ns,mV,nm", 1e-3, 1e-3),
        ("t,u,x\n[s],[V],[m]", 1.0, 1e6),
        ("Time (s),U (V),X (um)", 1.0, 1.0),
    ],
)
def test_units_of_columns_are_read(tmp_path, header, v_per, um_per):
    path = tmp_path / "loop.csv"
    path.write_text(header + "\n" + table_text(np.column_stack([TIME, U / v_per, X / um_per])))
    (record,) = read(path, inputs=["2"], outputs=["3"])
    np.testing.assert_allclose(record.u_v[0], U, atol=2e-9 * v_per)
    np.testing.assert_allclose(record.y_um[0], X, atol=2e-9 * um_per)
    assert not any("m" in name.lower().replace("um", "") for name in record.inputs)


def test_a_scale_takes_the_place_of_the_unit(tmp_path):
    path = tmp_path / "loop.csv"
    path.write_text("t,u_mV,x_V\n" + table_text(np.column_stack([TIME, U, X / 8.0])))
    (record,) = read(path, inputs=["u_mV"], outputs=["x_V"], input_scale=1.0, output_scale=8.0)
    np.testing.assert_allclose(record.u_v[0], U, atol=1e-8)
    np.testing.assert_allclose(record.y_um[0], X, atol=1e-7)
    assert record.inputs == ("u",)


@pytest.mark.parametrize(
    ("header", "inputs", "outputs"),
    [
        ("t,Vx [V],X (nm)", ("Vx",), ("X",)),
        ("t,Vx_mV,Weg in nm", ("Vx",), ("Weg",)),
        ("t,x [V],x [um]", ("x",), ("x",)),
        ("t,[mV],[nm]", ("V",), ("um",)),
        ("t,u_x,y_m", ("u_x",), ("y_m",)),
    ],
)
def test_an_axis_is_called_without_the_unit_of_its_column(tmp_path, header, inputs, outputs):
    path = tmp_path / "loop.csv"
    path.write_text(header + "\n" + table_text(np.column_stack([TIME, 1e3 * U, 1e3 * X])))
    (record,) = read(path, inputs=["2"], outputs=["3"], input_scale=1e-3, output_scale=1e-3)
    assert (record.inputs, record.outputs) == (inputs, outputs)


@pytest.mark.parametrize(
    ("units", "factors"),
    [("s,V,um", (1.0, 1.0)), ("[s],[V],[nm]", (1.0, 1e-3)), ("s,V,m", (1.0, 1e6)), ("ms,v,nm", (1.0, 1e-3))],
)
def test_a_letter_in_a_row_of_units_is_a_unit(tmp_path, units, factors):
    """A lone V, s or m may be part of a name, but not in a row of units: columns are found by it."""
    to_s = 1e-3 if units.startswith("ms") else 1.0
    path = tmp_path / "loop.csv"
    rows = np.column_stack([TIME / to_s, U / factors[0], X / factors[1]])
    path.write_text(f"time,voltage,position\n{units}\n" + table_text(rows))
    (record,) = read_records([path])
    assert (record.inputs, record.outputs) == (("voltage",), ("position",))
    np.testing.assert_allclose(record.u_v[0], U, atol=1e-7)
    np.testing.assert_allclose(record.y_um[0], X, atol=1e-1 if factors[1] == 1e6 else 1e-6)


def test_a_voltage_is_no_displacement(tmp_path):
    path = tmp_path / "loop.csv"
    path.write_text("t,u [V],x [um]\n" + table_text(np.column_stack([TIME, U, X])))
    text = message(read, path, inputs=["x [um]"], outputs=["u [V]"])
    assert "is in um, which is not a voltage: are --inputs and --outputs swapped?" in text
    assert "is in V, which is not a displacement" in text


@pytest.mark.parametrize(("name", "factor"), [("time_ms", 1e3), ("t [us]", 1e6), ("Time (ms)", 1e3)])
def test_a_time_in_another_unit_is_read(tmp_path, name, factor):
    path = tmp_path / "loop.csv"
    path.write_text(f"{name},u_x,x\n" + table_text(np.column_stack([TIME * factor, U, X])))
    assert read(path, time=name, rate_hz=None)[0].sample_time_s == 5e-3


def test_columns_of_one_name_get_names_of_their_own(tmp_path):
    path = tmp_path / "scope.csv"
    path.write_text("second,Volt,Volt,x,x\n" + table_text(np.column_stack([TIME, U, 0.5 * U, X, -X])))
    for inputs, outputs in ((["2", "3"], ["4", "5"]), (["2", "Volt_2"], ["4", "x_2"])):
        (record,) = read_records([path], inputs=inputs, outputs=outputs, rate_hz=200.0)
        assert record.inputs == ("Volt", "Volt_2")
        assert record.outputs == ("x", "x_2")
        np.testing.assert_allclose(record.u_v[1], 0.5 * U, atol=1e-9)
    text = message(read, path, inputs=["Volt"], outputs=["4"])
    assert "is 2 times in the header; give its number, 2 and 3" in text


def test_names_stay_unique_when_their_units_become_one(tmp_path):
    path = tmp_path / "loop.csv"
    path.write_text("u_mV,u_V,x\n" + table_text(np.column_stack([1e3 * U, 2 * U, X])))
    (record,) = read_records([path], inputs=["1", "2"], outputs=["3"], rate_hz=200.0)
    assert len(set(record.inputs)) == 2
    np.testing.assert_allclose(record.u_v, [U, 2 * U], atol=1e-8)


@pytest.mark.parametrize("unit", [1.0, 1e3, 1e6])
@pytest.mark.parametrize("digits", [9, 3])
def test_a_rate_does_not_hide_the_gaps_of_a_time_column(tmp_path, unit, digits):
    """Ten of 5 ms samples are missing, whatever the column's unit is and however few its digits."""
    kept = np.delete(np.arange(N), np.arange(100, 110))
    rows = np.column_stack([np.round(TIME, digits) * unit, U, X])
    path = tmp_path / "gap.csv"
    path.write_text("t,u_x,x\n" + table_text(rows[kept]))
    assert "about 10 samples are missing, which --rate does not repair" in message(read, path)
    path.write_text("t,u_x,x\n" + table_text(rows))
    assert read(path)[0].samples == N
    jitter = rows + np.array([1.0, 0.0, 0.0]) * 1e-3 * unit * np.random.default_rng(1).uniform(-1, 1, (N, 1))
    path.write_text("t,u_x,x\n" + table_text(jitter))
    assert read(path)[0].samples == N


def test_gains_of_all_pairs_and_doubts():
    other = np.roll(U, 37)
    records = [
        Record([U, 0 * U], [5.0 * U, 0.1 * U], 1e-3),
        Record([U, other], [5 * U + other, 3 * other], 1e-3),
    ]
    gains = {(g.input, g.output): g for g in pair_gains(records)}
    assert gains["u1", "y1"].um_per_v == pytest.approx(5.0, rel=1e-9)
    assert gains["u2", "y1"].um_per_v == pytest.approx(1.0, rel=1e-9)
    assert gains["u2", "y2"].um_per_v == pytest.approx(3.0, rel=2e-2)
    assert gains["u1", "y1"].span_v == pytest.approx(20.0)
    alone = pair_gains(
        [Record([U, 0 * U], [5.0 * U, 0.1 * U], 1e-3), Record([0 * U, U], [0.2 * U, 4 * U], 1e-3)]
    )
    assert [g.span_um for g in alone] == pytest.approx([100.0, 2.0, 4.0, 80.0], rel=1e-3)
    assert doubtful_gains(list(gains.values())) == []
    for scale, word in ((1e-4, "0.0005"), (1e3, "5e+03")):
        doubts = doubtful_gains(pair_gains([Record([U], [scale * 5.0 * U], 1e-3)]))
        assert len(doubts) == 1
        assert word in doubts[0]


@pytest.mark.parametrize(("um_per_v", "doubted"), [(9e-4, 1), (1.5e-3, 0), (900.0, 0), (1100.0, 1)])
def test_a_gain_is_doubted_where_no_actuator_has_it(um_per_v, doubted):
    assert len(doubtful_gains([Gain("u", "x", 100.0, 100.0 * um_per_v, -um_per_v)])) == doubted


@pytest.mark.parametrize("turn", [1, 2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_outputs_that_follow_the_inputs_of_others_are_named(turn, sign):
    """Exchanged columns passed as an excellent fit, and its drives missed by all of the travel."""
    rng = np.random.default_rng(3)
    u = rng.uniform(-10.0, 10.0, (3, 4000))
    own = np.diag([5.0, 6.0, 7.0]) * sign + 0.3
    plain, crossed = ([Record(u, gains @ u, 1e-3)] for gains in (own, np.roll(own, turn, axis=0)))
    assert doubtful_order(pair_gains(plain)) == []
    (said,) = doubtful_order(pair_gains(crossed))
    assert said.count(" follows ") == 3
    two = [Record(u[:2], own[[0, 0], :2] @ u[:2], 1e-3)]  # both follow the first input
    assert doubtful_order(pair_gains(two)) == []


def test_a_column_is_found_without_its_unit(tmp_path):
    """``Vx`` is the column headed ``Vx [V]``; two that differ by their unit alone are asked about."""
    path = tmp_path / "stage.csv"
    path.write_text("Time [s],Vx [V],X [um],X [nm]\n0,0,0,0\n0.1,10,5,5000\n0.2,20,9,9000\n")
    columns = read_columns(path, ["time", "vx", "X [um]"])
    assert columns.names == ("Time [s]", "Vx [V]", "X [um]")
    with pytest.raises(InputError, match="is 2 times in the header; give its number, 3 and 4"):
        read_columns(path, ["Vx", "X"])
    with pytest.raises(InputError, match=r"Vy.*is not in the file"):
        read_columns(path, ["Vy"])


def _ended(words):
    with pytest.raises(SystemExit) as ended:
        main(words)
    return ended.value.code or 0


def _run(words):
    assert _ended(words) == 0


@pytest.mark.parametrize(("factor", "told"), [(1.0, 0), (1e3, 1)])
def test_milliseconds_taken_for_seconds_are_told_by_loops(tmp_path, capsys, factor, told):
    """A record of 0.4 s at 10 kHz; and the same where its milliseconds stand under ``time_s``."""
    time_s = np.arange(4000) * 1e-4
    u = 50.0 * (1.0 - np.cos(2.0 * np.pi * 10.0 * time_s))
    rows = np.c_[factor * time_s, u, 0.1 * u]
    names = "time_s,drive_x_v,measured_x_um"
    np.savetxt(tmp_path / "r.csv", rows, delimiter=",", header=names, comments="", fmt="%.9g")
    loops = ["loops", str(tmp_path / "r.csv"), "--no-figures"]
    _run(loops)
    said = capsys.readouterr().err
    assert said.count("If its times are in milliseconds, name their column t_ms") == told
    np.savetxt(tmp_path / "r.csv", rows, delimiter=",", header=names.replace("_s", "_ms"), comments="")
    _run(loops)
    assert "milliseconds" not in capsys.readouterr().err


def test_a_slow_record_of_few_samples_a_cycle_is_not_doubted():
    u = np.sin(2.0 * np.pi * 0.1 * np.arange(600) / 5.0)
    assert list(doubtful_clocks([Record([u], [u], 0.2)])) == []


def test_one_sample_every_few_minutes_is_doubted_however_few_a_cycle_has():
    """A converter of 10 kHz whose times are in microseconds and are taken for seconds."""
    u = np.sin(2.0 * np.pi * np.arange(600) / 20.0)
    assert "in microseconds, name their column t_us" in next(doubtful_clocks([Record([u], [u], 100.0)]))


def _written(path, names, *columns):
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=names, comments="", fmt="%.9g")


STEADY = np.arange(4000) * 1e-3
DRIVEN = np.where(STEADY < 2.0, 10.0, 7.0) * np.sin(2.0 * np.pi * 5.0 * STEADY)
MOVED = 3.0 * DRIVEN + play(DRIVEN, [1.0])[0] + np.random.default_rng(0).normal(0.0, 0.01, 4000)


@pytest.mark.parametrize("command", ["loops", "identify"])
@pytest.mark.parametrize("jump_um", [500.0, -30.0])
def test_an_output_that_jumps_alone_is_doubted(tmp_path, capsys, command, jump_um):
    _written(tmp_path / "r.csv", "t_s,u_v,y_um", STEADY, DRIVEN, MOVED + jump_um * (STEADY >= 2.5))
    line = [command, str(tmp_path / "r.csv"), "--no-figures"]
    line += ["--out", str(tmp_path / "m.json")] if command == "identify" else []
    assert _ended(line) == 2
    assert "um at row 2502, but no voltage jumps: cut the record there" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("u", "y"),
    [
        (DRIVEN, MOVED),
        (np.sign(DRIVEN), np.sign(DRIVEN)),
        (DRIVEN[::17], MOVED[::17]),
        (DRIVEN, np.random.default_rng(1).normal(size=4000)),
        (DRIVEN, np.round(MOVED / 10.0) * 10.0),
    ],
    ids=["smooth", "stepped", "coarse", "noise", "eight levels"],
)
def test_what_follows_a_voltage_or_is_noise_does_not_jump(u, y):
    assert list(doubtful_jumps([Record([u], [y], 1e-3)])) == []


def test_a_jump_counts_beside_the_output_that_moves_most():
    """A tenth of the motion may be a slip; an output that hardly moves makes it no more doubtful."""
    slipped = MOVED + 0.1 * np.ptp(MOVED) * (STEADY >= 2.5)
    for outputs in ([slipped], [slipped, 0.01 * DRIVEN]):
        assert list(doubtful_jumps([Record([DRIVEN], outputs, 1e-3)])) == []


def test_a_jump_that_is_accepted_is_fitted(tmp_path):
    """No fitted threshold has a slope that was measured, as those of the jump are far steeper."""
    _written(tmp_path / "r.csv", "t_s,u_v,y_um", STEADY, DRIVEN, MOVED + 500.0 * (STEADY >= 2.5))
    line = ["identify", str(tmp_path / "r.csv"), "--no-figures", "--accept-gain", "--operators", "4"]
    assert _ended([*line, "--dynamics", "none", "--out", str(tmp_path / "m.json")]) == 0


@pytest.mark.full
def test_seconds_taken_for_microseconds_are_told_and_fitted(tmp_path, capsys):
    """4 s under ``t [us]``: a rate of 1 GHz, at which a lag of a part of a sample is none of an axis."""
    _written(tmp_path / "r.csv", "t [us],u [V],y [um]", STEADY, DRIVEN, MOVED)
    line = ["identify", str(tmp_path / "r.csv"), "--no-figures", "--operators", "4"]
    assert _ended([*line, "--out", str(tmp_path / "m.json")]) == 0
    assert capsys.readouterr().err.count("If its times are in seconds, name their column t_s") == 1


@pytest.mark.parametrize("resonance_hz", [20.0, 100.0, 400.0])
@pytest.mark.parametrize("damping", [0.02, 0.1])
def test_an_output_beyond_its_resonance_answers(resonance_hz, damping):
    """White voltage up to 5 kHz: that of the same instant, its square and rate explain under 2 % of it."""
    rng, pole = np.random.default_rng(1), 2e-4 * np.pi * resonance_hz * (-damping + 1j)
    u, a = rng.normal(size=8192), [1.0, -2.0 * np.exp(pole).real, np.exp(2.0 * pole.real)]
    y = lfilter([0.0, sum(a)], a, u)
    y += 0.001 * y.std() * rng.normal(size=y.shape)
    x = np.stack([u, u**2, np.gradient(u), np.ones_like(u)])
    left = y - np.linalg.lstsq(x.T, y, rcond=None)[0] @ x
    assert left.var() > 0.98 * y.var()
    assert not list(doubtful_responses([Record([u], [y], 1e-4, verified=True)]))


@pytest.mark.parametrize("samples", [60, 300, 8192])
@pytest.mark.parametrize("seed", range(8))
def test_noise_of_any_length_answers_to_nothing(samples, seed):
    """Of three voltages and three outputs: with 60 samples, chance alone explains 15 % of each."""
    rng = np.random.default_rng(seed)
    noise = Record(rng.normal(size=(3, samples)), rng.normal(size=(3, samples)), 1e-4, verified=True)
    assert list(doubtful_responses([noise]))


@pytest.mark.parametrize("kind", ["creep", "square", "hysteresis"])
def test_slow_and_square_outputs_answer(kind):
    u = np.sin(np.arange(2000) / 20.0)
    y = {"creep": lfilter([0.01], [1.0, -0.99], u), "square": u**2, "hysteresis": play(u, [0.6])[0]}[kind]
    y = y + 0.02 * y.std() * np.random.default_rng(1).normal(size=y.shape)
    assert not list(doubtful_responses([Record([u], [y], 1e-4, verified=True)]))
