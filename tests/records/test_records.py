"""What is refused in records, and several experiments on one actuator."""

from __future__ import annotations

import json

import numpy as np
import pytest
import scipy.io
from record_cases import N, U, X, message, plays

from hammerstein.commands.cli import main
from hammerstein.errors import InputError
from hammerstein.records.checks import sample_time, time_tolerance
from hammerstein.records.gains import lag_rad, pair_gains
from hammerstein.records.loops import loop_table
from hammerstein.records.reading import read_paired_records, read_records
from hammerstein.records.record import Record, driven_inputs


class TestRecord:
    def test_arrays_are_copies_that_nobody_can_change(self):
        u = U.copy()
        record = Record([u], [X], 5e-3)
        u[0] = 99.0
        assert record.u_v[0, 0] == 0.0
        for array in (record.u_v, record.y_um, record.rows):
            with pytest.raises(ValueError, match="read-only"):
                array[..., 0] = 1

    def test_part_keeps_rows_and_is_not_searched_again(self):
        record = Record([U], [X], 5e-3, rows=np.arange(11, 411))
        part = record.part(100, 105)
        assert part.rows.tolist() == [111, 112, 113, 114, 115]
        np.testing.assert_array_equal(part.u_v[0], U[100:105])
        assert record.rate_hz == 200.0

    @pytest.mark.parametrize(
        ("u", "y", "what"),
        [
            (U, [X], r"u_v has shape \(400,\)"),
            ([U], [X[:-1]], r"y_um \(1, 399\)"),
            (np.empty((0, 4)), [X[:4]], r"u_v has shape \(0, 4\)"),
        ],
    )
    def test_shapes(self, u, y, what):
        with pytest.raises(InputError, match=what):
            Record(u, y, 5e-3)

    def test_names_must_fit(self):
        assert "has 1 inputs, 1 outputs and 400 samples, but 2 input names" in message(
            Record, [U], [X], 5e-3, inputs=("a", "b")
        )

    @pytest.mark.parametrize("step", [0.0, -1.0, float("nan")])
    def test_sample_time(self, step):
        assert "sample_time_s" in message(Record, [U], [X], step)

    def test_gaps_are_named_by_column_and_rows(self):
        u, x = U.copy(), X.copy()
        u[9] = np.nan
        x[20:25] = np.inf
        text = message(Record, [u], [x], 5e-3, ("ux",), ("x",), "loop")
        assert text.splitlines()[0] == "loop: 2 mistakes"
        assert "column ux, row 10 " in text
        assert "column x, rows 21 to 25  gap of 5 samples" in text

    def test_many_gaps_are_counted(self):
        x = X.copy()
        x[::10] = np.nan
        assert "35 more gaps" in message(Record, [U], [x], 5e-3)

    def test_too_short(self):
        assert "10 samples are too few" in message(Record, [U[:10]], [X[:10]], 5e-3)

    def test_constant_columns(self):
        text = message(Record, [0 * U + 1.5], [0 * X - 317.2], 5e-3, ("ux",), ("x",))
        assert "column ux, rows 1 to 400  constant input, always 1.5; add a record that drives it" in text
        assert "column x, rows 1 to 400   constant output, always -317.2; check the sensor" in text

    def test_one_axis_may_rest(self):
        record = Record([U, 0 * U], [X, 0 * X], 5e-3)
        assert driven_inputs(record) == (0,)

    @pytest.mark.parametrize(("scale", "unit"), [(1e-6, "m"), (1e-6, "mm"), (1e3, "nm")])
    def test_impossible_units_of_the_output(self, scale, unit):
        text = message(Record, [U], [scale * X], 5e-3)
        assert f"--units {unit}" in text

    @pytest.mark.parametrize(("scale", "unit", "remedy"), [(1e-6, "kV", "1e3"), (1e3, "mV", "1e-3")])
    def test_impossible_units_of_the_input(self, scale, unit, remedy):
        text = message(Record, [scale * U], [X], 5e-3)
        assert f"--input-scale {remedy} if" in text
        assert f"is in {unit}" in text

    def test_a_small_cross_coupling_is_no_matter_of_units(self):
        assert Record([U], [X, 1e-5 * X], 5e-3).samples == N


class TestClipping:
    @pytest.mark.parametrize("level", [35.0, 53.0])
    def test_clipped_sensor(self, level):
        clipped = np.minimum(X, level)
        top = int(np.argmax(clipped == level))
        last = top + int(np.argmin(clipped[top:] == level))
        text = message(Record, [U], [clipped], 5e-3, ("ux",), ("x",), "loop")
        assert f"column x, rows {top + 1} to {last}" in text
        assert f"stays at {level:g} while the voltage moves on (2 such places)" in text
        assert "lower the amplitude or use a larger range" in text
        assert "or inputs and outputs are swapped" in text  # voltages that wait at 0 V look the same

    def test_clipped_below_and_second_axis(self):
        text = message(Record, [U, 0 * U], [X, np.maximum(-X, -40.0)], 5e-3)
        assert "column y2" in text
        assert "column y1" not in text

    def test_a_hysteretic_output_may_stand_after_a_reversal(self):
        wide = plays(U, np.array([5.0]))[0]
        assert (wide == wide.max()).sum() > 20
        assert Record([U], [wide], 5e-3).samples == N

    def test_quantised_outputs_stand_for_a_step(self):
        for step in (0.04, 1.0, 5.0):
            assert Record([U], [np.round(X / step) * step], 5e-3).samples == N

    def test_plateaus_and_a_dead_start_are_no_clipping(self):
        u = np.interp(np.arange(600), [0, 100, 250, 350, 500, 560, 599], [0, 0, 10, 10, -10, -10, 0])
        x = np.array([4.0, 1.0]) @ plays(u, np.array([0.1, 2.0]))
        assert Record([u], [x], 5e-3).samples == 600


class TestSeveralExperiments:
    def write(self, tmp_path, u, y):
        paths = []
        for k, (a, b) in enumerate(zip(u, y, strict=True)):
            paths.append(tmp_path / f"{k}.csv")
            np.savetxt(paths[-1], np.column_stack([*a, *b]), delimiter=",", header="ux,uy,x,y")
        return paths

    def test_one_input_driven_at_a_time(self, tmp_path):
        rng = np.random.default_rng(1)
        held = 0.001 * rng.standard_normal(N)
        paths = self.write(tmp_path, [[U, held], [held, U]], [[X, 0 * X], [0.1 * X, X]])
        records = read_records(paths, inputs=["ux", "uy"], outputs=["x", "y"], rate_hz=200.0)
        assert [driven_inputs(record) for record in records] == [(0,), (1,)]

    def test_an_input_that_is_never_driven(self, tmp_path):
        paths = self.write(tmp_path, [[U, 0 * U], [U, 0 * U]], [[X, 1e-6 * X], [X, 1e-6 * X]])
        text = message(read_records, paths, inputs=["ux", "uy"], outputs=["x", "y"], rate_hz=200.0)
        assert text.startswith("2 records: 2 mistakes")
        assert "column uy  constant input, always 0" in text
        assert "column y   covers 0.000" in text

    def test_paired_arrays(self, tmp_path):
        rng = np.random.default_rng(1)
        u = rng.standard_normal((100, 2, 3, 4))
        y = np.stack([u.sum(axis=1)] * 3, axis=1) * 1e-6
        np.save(tmp_path / "u.npy", u)
        np.save(tmp_path / "y.npy", y)
        axes = ("sample", "channel", "experiment", "period")
        records = read_paired_records(
            tmp_path / "u.npy", tmp_path / "y.npy", axes=axes, rate_hz=100.0, output_scale=1e6
        )
        assert len(records) == 3
        assert records[1].period_samples == 100
        np.testing.assert_array_equal(records[1].u_v, np.hstack([u[:, :, 1, k].T for k in range(4)]))
        np.testing.assert_allclose(records[2].y_um[2, 300:], 1e6 * y[:, 2, 2, 3])
        text = message(read_paired_records, tmp_path / "u.npy", tmp_path / "y.npy", axes=axes, rate_hz=100.0)
        assert text.count("try --units m or --units mm") == 3
        assert "experiment 3, column" in text

    def test_paired_arrays_that_do_not_fit(self, tmp_path):
        np.save(tmp_path / "u.npy", np.outer(U, [1.0, 2.0]))
        np.save(tmp_path / "y.npy", np.outer(X, [1.0, 2.0, 3.0]))
        pair = tmp_path / "u.npy", tmp_path / "y.npy"
        assert len(read_paired_records(*pair, rate_hz=200.0)) == 1
        assert "2 experiments, 1 periods, 400 samples and 3 experiments" in message(
            read_paired_records, *pair, axes=("sample", "experiment"), rate_hz=200.0
        )
        assert "shape (400, 2), but the axes are sample" in message(
            read_paired_records, *pair, axes=("sample",), rate_hz=200.0
        )
        assert "name sample" in message(read_paired_records, *pair, axes=("time",), rate_hz=200.0)
        assert "is not a file of arrays" in message(read_paired_records, __file__, pair[1], rate_hz=200.0)


def test_a_cell_that_no_displacement_is_is_named_before_anything_is_summed():
    t = np.arange(400) / 100.0
    u, y = np.sin(t)[None], 3.0 * np.sin(t)[None]
    y[0, 7] = 1e300
    with pytest.raises(InputError, match=r"column x, row 8 +holds 1e\+300 um, which must be -1e9 to 1e9"):
        Record(u, y, 0.01, ["u"], ["x"])


class TestPairsOnTheCommandLine:
    """``--axes`` reads what ``read_paired_records`` reads, and its mistakes are those of options."""

    @pytest.fixture
    def pair(self, tmp_path):
        scipy.io.savemat(tmp_path / "both.mat", {"u": np.outer(U, [1.0, 0.5]), "x": np.outer(X, [1.0, 0.5])})
        np.save(tmp_path / "u.npy", np.outer(U, [1.0, 0.5]))
        np.save(tmp_path / "x.npy", np.outer(X, [1.0, 0.5]))
        return tmp_path

    @staticmethod
    def loops(*words):
        with pytest.raises(SystemExit) as end:
            main(["loops", "--json", "--no-figures", *map(str, words)])
        return end.value.code

    @pytest.mark.parametrize(
        "names", [("u.npy", "x.npy"), ("both.mat", "both.mat", "--inputs", "u", "--outputs", "x")]
    )
    def test_every_experiment_is_a_record(self, pair, capsys, names):
        files = [pair / name if "." in name else name for name in names]
        assert self.loops(*files, "--axes", "sample,experiment", "--rate", "200") == 0
        found = json.loads(capsys.readouterr().out)["loops"]
        alone = [loop for record in self.records(pair) for loop in loop_table(record)]
        assert [loop["height_um"] for loop in found] == [loop.height_um for loop in alone]
        assert {loop["file"].rpartition(", ")[2] for loop in found} == {"experiment 1", "experiment 2"}

    @staticmethod
    def records(pair):
        return read_paired_records(
            pair / "u.npy", pair / "x.npy", axes=("sample", "experiment"), rate_hz=200.0
        )

    @pytest.mark.parametrize(
        ("words", "told"),
        [
            (["x.npy", "u.npy", "--rate", "200"], "come in pairs, first voltages"),
            (["x.npy"], "use --rate instead of --time"),
            (["x.npy", "--rate", "200", "--axes", "sample,chanel"], "--axes: are sample, chanel"),
            (["x.npy", "--rate", "200", "--inputs", "w"], "there is no variable w"),
            (["x.npy", "--rate", "200", "--output-scale", "0"], "--output-scale"),
            (["none.npy", "--rate", "200"], "does not exist"),
        ],
    )
    def test_mistakes(self, pair, capsys, monkeypatch, words, told):
        monkeypatch.chdir(pair)
        assert self.loops("u.npy", "--axes", "sample,experiment", *words) == 2
        assert told in capsys.readouterr().err


@pytest.mark.parametrize("samples", [20, 333])
@pytest.mark.parametrize("step_s", [np.pi * 1e-5, np.pi])
def test_a_time_of_many_digits_may_be_off_by_a_tenth_of_a_sample(samples, step_s):
    time_s = 0.7 + step_s * np.arange(samples)
    assert sample_time(time_s) == pytest.approx(step_s, rel=1e-12)
    assert time_tolerance(time_s) == pytest.approx(0.1 * step_s, rel=1e-12)


@pytest.mark.parametrize(("v", "um", "order"), [(0.125, 8.0, [0, 1]), (1.0, 1.0, [1, 0])])
def test_what_is_said_of_a_record_has_its_units_and_goes_with_its_axes(v, um, order):
    """One axis after the other, with cross-couplings of either sign and noise."""

    def told(v, um, order):
        drive = np.concatenate([U, 0.0 * U]), np.concatenate([0.0 * U, 0.7 * U])
        moved = np.array([plays(u, [0.5, 3.0]).T @ [3.0, 1.0] for u in drive])
        y = [[1.0, -0.2], [0.1, 0.8]] @ moved + 0.02 * np.random.default_rng(3).standard_normal((2, 2 * N))
        names = [tuple(own[k] for k in order) for own in ("ab", "xy")]
        one = Record(v * np.array(drive)[order], um * y[order], 5e-3, *names)
        gains = {
            (g.input, g.output): (g.span_v / v, g.span_um / um, g.um_per_v * v / um)
            for g in pair_gains([one])
        }
        lags = lag_rad([one])
        for (o, k), lag in np.ndenumerate(lags):
            gains[names[0][k], names[1][o]] += (lag,)
        parts = {"amplitude_v": v, "mid_v": v, "area_v_um": v * um} | dict.fromkeys(
            ("height_um", "width_um", "closure_um", "drift_um"), um
        )
        loops = {
            (loop.input, loop.output, loop.start, loop.turn, loop.stop, loop.settled): tuple(
                getattr(loop, name) / unit for name, unit in parts.items()
            )
            for loop in loop_table(one)
        }
        return gains, loops

    for one, other in zip(told(1.0, 1.0, [0, 1]), told(v, um, order), strict=True):
        assert len(one) >= 4
        assert other == {key: pytest.approx(values, rel=1e-9, abs=1e-12) for key, values in one.items()}


def test_a_record_that_is_transposed_is_told_to_be_turned():
    column = np.sin(np.arange(200.0))[:, None]
    with pytest.raises(InputError, match=r"u_v has shape \(200, 1\), more inputs than samples; transpose it"):
        Record(column, column, 1e-3)


def test_a_record_is_told_by_its_axes_and_their_ranges():
    u = np.linspace(-3.0, 4.0, 100)
    told = repr(Record([u, 2.0 * u], [0.5 * u], 1e-3, inputs=("a", "b"), outputs=("x",)))
    assert told.endswith("100 samples of 1 ms; a -3 to 4 V, b -6 to 8 V; x -1.5 to 2 um)")
