"""Reading records, what is refused in them, and what is found out before a fit."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io

from hammerstein.errors import InputError
from hammerstein.identification.preparation import (
    driven_inputs,
    estimate_delay,
    lag_rad,
    leads,
    prepare,
    refuse_swapped,
)
from hammerstein.identification.readers import read_array, read_columns
from hammerstein.identification.record_checks import sample_time, time_mistakes
from hammerstein.identification.records import Record, read_paired_records, read_records

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"

N = 400
TIME = 5e-3 * np.arange(N)
U = 10.0 * np.sin(2.0 * np.pi * np.arange(N) / 200)


def plays(u, thresholds, start=0.0):
    """Textbook play operators: (operator, sample)."""
    p, out = np.full(len(thresholds), start), np.empty((len(thresholds), len(u)))
    for k, value in enumerate(u):
        p = np.maximum(value - thresholds, np.minimum(value + thresholds, p))
        out[:, k] = p
    return out


THRESHOLDS = np.array([0.07, 1.0, 3.0, 6.0])
X = np.array([4.0, 0.5, 0.8, 1.2]) @ plays(U, THRESHOLDS)


def message(call, *args, **kwargs) -> str:
    with pytest.raises(InputError) as caught:
        call(*args, **kwargs)
    return str(caught.value)


def table_text(rows, separator=",", decimal=".", end="\n", tail=""):
    lines = (separator.join(f"{value:.9f}".replace(".", decimal) for value in row) + tail for row in rows)
    return end.join(lines) + end


@pytest.fixture
def table():
    return np.column_stack([TIME, U, X])


@pytest.fixture
def csv(tmp_path, table):
    """Write lines of a CSV file, changed by the caller, and return its path."""

    def write(change=lambda lines: None, name="loop.csv"):
        lines = ["t,u_x,x", *table_text(table).splitlines()]
        change(lines)
        path = tmp_path / name
        path.write_text("\n".join(lines) + "\n")
        return path

    return write


def read(path, **changes):
    options = {"inputs": ["u_x"], "outputs": ["x"], "rate_hz": 200.0} | changes
    return read_records([path], **options)


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
        assert "10 samples are too short" in message(Record, [U[:10]], [X[:10]], 5e-3)

    def test_constant_columns(self):
        text = message(Record, [0 * U + 1.5], [0 * X - 317.2], 5e-3, ("ux",), ("x",))
        assert "column ux, rows 1 to 400  constant input, always 1.5; drive it" in text
        assert "column x, rows 1 to 400   constant output, always -317.2; check the sensor" in text

    def test_one_axis_may_rest(self):
        record = Record([U, 0 * U], [X, 0 * X], 5e-3)
        assert driven_inputs(record) == (0,)

    @pytest.mark.parametrize(
        ("scale", "unit", "remedy"), [(1e-6, "m", "1e6"), (1e-6, "mm", "1e3"), (1e3, "nm", "1e-3")]
    )
    def test_impossible_units_of_the_output(self, scale, unit, remedy):
        text = message(Record, [U], [scale * X], 5e-3)
        assert f"--output-scale {remedy} if the file is in {unit}" in text

    @pytest.mark.parametrize(("scale", "unit", "remedy"), [(1e-6, "kV", "1e3"), (1e3, "mV", "1e-3")])
    def test_impossible_units_of_the_input(self, scale, unit, remedy):
        text = message(Record, [scale * U], [X], 5e-3)
        assert f"--input-scale {remedy} if the file is in {unit}" in text

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
        assert f"stands at {level:g} while the voltage goes on (2 such stretches)" in text
        assert "lower the amplitude or use a larger range" in text

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


class TestTextFiles:
    @pytest.mark.parametrize(
        ("separator", "decimal", "end", "tail"),
        [
            (",", ".", "\n", ""),
            (", ", ".", "\n", ""),
            (",", ".", "\r\n", ","),
            (";", ".", "\n", ";"),
            (";", ",", "\r\n", ""),
            ("\t", ".", "\n", ""),
            ("\t", ",", "\n", "\t"),
            ("  ", ".", "\n", "  "),
            (" ", ",", "\n", ""),
        ],
    )
    @pytest.mark.parametrize("header", ["", "t{s}u_x{s}x{e}", "# made by hand{e}# t{s}u_x{s}x{e}"])
    def test_layouts(self, tmp_path, table, separator, decimal, end, tail, header):
        path = tmp_path / "loop.txt"
        text = header.format(s=separator, e=end) + table_text(table, separator, decimal, end, tail)
        path.write_bytes(text.encode())
        names = ["u_x", "x"] if header else ["2", "3"]
        (record,) = read_records([path], inputs=names[:1], outputs=names[1:], rate_hz=200.0)
        np.testing.assert_allclose(record.u_v[0], U, atol=1e-9)
        np.testing.assert_allclose(record.y_um[0], X, atol=1e-9)
        assert record.inputs == ("u_x",) if header else ("2",)
        assert record.rows[0] == 1 + header.count("{e}")

    @pytest.mark.parametrize(
        ("encoding", "name"), [("utf-8-sig", "Weg µm"), ("latin-1", "Weg µm"), ("utf-16", "Weg µm")]
    )
    def test_encodings(self, tmp_path, table, encoding, name):
        path = tmp_path / "loop.csv"
        path.write_text(f"t;u;{name}\n" + table_text(table, ";", ","), encoding=encoding)
        (record,) = read_records([path], inputs=["u"], outputs=[name], time="t")
        np.testing.assert_allclose(record.y_um[0], X, atol=1e-9)
        assert record.sample_time_s == 5e-3

    def test_byte_order_mark_without_header(self, tmp_path, table):
        path = tmp_path / "loop.csv"
        path.write_text(table_text(table[:, 1:]), encoding="utf-8-sig")
        (record,) = read(path, inputs=["1"], outputs=["2"])
        assert (record.samples, record.rows[0]) == (N, 1)

    def test_names_that_python_takes_for_numbers(self, tmp_path, table):
        path = tmp_path / "loop.csv"
        path.write_text("1_0,1_1,1_2\n" + table_text(table))
        assert read(path, inputs=["1_1"], outputs=["1_2"])[0].inputs == ("1_1",)

    def test_quotation_marks(self, csv):
        def quote(lines):
            lines[1:] = [",".join(f'"{field}"' for field in line.split(",")) for line in lines[1:]]

        np.testing.assert_allclose(read(csv(quote))[0].u_v[0], U, atol=1e-9)

        def leave_open(lines):
            lines[100] = lines[100].replace(",", ',"', 1)
            lines[110] += '"'

        assert "is a quotation mark left open?" in message(read, csv(leave_open))

    def test_preamble_and_row_of_units(self, tmp_path, table):
        path = tmp_path / "scope.csv"
        head = "Device,OFV 5000\nSampling rate,200\n\nt,u_x,x\ns,V,um\n"
        path.write_text(head + table_text(table))
        (record,) = read(path, time="t", rate_hz=None)
        assert record.rows[0] == 6
        assert record.outputs == ("x",)

    def test_a_column_of_text_that_is_not_wanted(self, tmp_path, table):
        path = tmp_path / "log.csv"
        lines = table_text(table).splitlines()
        path.write_text("when,t,u_x,x\n" + "\n".join(f"12:00:{k:03d},{line}" for k, line in enumerate(lines)))
        (record,) = read(path)
        np.testing.assert_allclose(record.u_v[0], U, atol=1e-9)
        assert "'12:00:000' is text in a column of numbers" in message(read, path, outputs=["when"])

    def test_comments_and_empty_lines_count_as_rows(self, csv):
        def change(lines):
            lines.insert(200, "# valve opened")
            lines.insert(100, "")
            lines[301] = lines[301].replace(",", ",bad", 1)

        text = message(read, csv(change))
        assert "column u_x, row 302  'bad" in text

    def test_text_in_a_number_column(self, csv):
        def change(lines):
            lines[1] = "0.0,volts,0.0"
            lines[77] = "0.38,1.0,overload"

        text = message(read, csv(change))
        assert "column u_x, row 2  'volts' is text" in text
        assert "column x, row 78   'overload' is text" in text
        assert text.count("row") >= 2
        assert "2 mistakes" in text

    def test_gaps_and_a_short_row(self, csv):
        def change(lines):
            lines[10] = "0.045,,1.0"
            lines[20] = "0.095,1.0"
            lines[30] = "0.145,nan,1.0"

        text = message(read, csv(change))
        assert "column u_x, row 11  holds no finite number" in text
        assert "column x, row 21    holds no finite number" in text
        assert "column u_x, row 31  holds no finite number" in text

    def test_a_long_row(self, csv):
        def change(lines):
            lines[50] += ",7,8"

        assert "row 51  has more columns than the others, which have 3" in message(read, csv(change))

    def test_empty_rows_at_the_end_are_dropped(self, csv):
        path = csv(lambda lines: lines.extend([",,", ",,", "", ""]))
        assert read(path)[0].samples == N

    def test_cut_last_line(self, csv):
        path = csv()
        path.write_text(path.read_text()[:-15])
        assert f"row {N + 1}" in message(read, path)

    def test_columns_by_number_and_any_case(self, csv):
        (record,) = read(csv(), inputs=["U_X"], outputs=["3"])
        assert (record.inputs, record.outputs) == (("u_x",), ("x",))

    def test_unknown_columns(self, csv):
        text = message(read, csv(), inputs=["u_z"], outputs=["9"])
        assert "column u_z  is not in the file; did you mean u_x? it has 1 t, 2 u_x, 3 x" in text
        assert "column 9" in text

    def test_unknown_column_without_header(self, csv):
        assert "no header: name columns by number, 1 to 3" in message(read, csv(lambda lines: lines.pop(0)))

    def test_name_that_stands_twice(self, csv):
        def change(lines):
            lines[0] = "t,x,x"

        assert "stands 2 times in the header; give its number, 2 and 3" in message(
            read, csv(change), inputs=["t"], outputs=["x"]
        )

    def test_one_column_named_twice(self, csv):
        assert "u_x is named twice" in message(read, csv(), outputs=["u_x"])
        assert "named twice, by name and by number" in message(read, csv(), outputs=["2"])


class TestFiles:
    def test_missing_empty_folder_binary_and_prose(self, tmp_path):
        (tmp_path / "empty.csv").touch()
        (tmp_path / "binary.dat").write_bytes(b"\0\1\2" * 100)
        (tmp_path / "prose.txt").write_text("nothing to see here\n" * 5)
        for name, what in [
            ("missing.csv", "does not exist"),
            ("empty.csv", r"is empty \(0 bytes\)"),
            ("", "is a folder"),
            ("binary.dat", "is a binary file; give CSV"),
            ("prose.txt", "holds no line of numbers"),
        ]:
            with pytest.raises(InputError, match=what):
                read(tmp_path / name)

    def test_mistakes_of_several_files_in_one_message(self, csv, tmp_path):
        def change(lines):
            lines[5] = "0.02,x,1.0"

        good, bad = csv(), csv(change, "bad.csv")
        text = message(
            read_records, [good, bad, tmp_path / "none.csv"], inputs=["u_x"], outputs=["x"], rate_hz=200.0
        )
        assert text.splitlines()[0] == "2 records: 2 mistakes"
        assert f"{bad}, column u_x, row 6" in text
        assert "none.csv " in text
        assert "does not exist" in text

    def test_arguments(self, csv):
        text = message(
            read_records,
            [],
            inputs=[],
            outputs=["x"],
            rate_hz=1.0,
            time="t",
            input_scale=0.0,
            output_scale=np.nan,
        )
        for what in ("no file", "inputs", "rate or time", "input scale", "output scale"):
            assert what in text
        assert "give one of them" in message(read, csv(), rate_hz=None)
        assert "must be above 0" in message(read, csv(), rate_hz=-5.0)

    @pytest.mark.parametrize(("array", "name"), [("rows", "2"), ("columns", "2")])
    def test_numpy_array_either_way_round(self, tmp_path, table, array, name):
        np.save(tmp_path / "a.npy", table if array == "rows" else table.T)
        (record,) = read(tmp_path / "a.npy", inputs=[name], outputs=["3"])
        np.testing.assert_array_equal(record.u_v[0], U)

    def test_numpy_fields(self, tmp_path, table):
        fields = np.zeros(N, dtype=[("u_x", "f4"), ("x", "f8")])
        fields["u_x"], fields["x"] = U, X
        np.save(tmp_path / "a.npy", fields)
        np.testing.assert_array_equal(read(tmp_path / "a.npy")[0].y_um[0], X)

    def test_numpy_archive_by_name_and_more_axes(self, tmp_path):
        u = np.zeros((N, 2, 3))
        u[:, 1, 2] = U
        np.savez(tmp_path / "a.npz", u=u, x=X)
        (record,) = read(tmp_path / "a.npz", inputs=["u:2:3"])
        np.testing.assert_array_equal(record.u_v[0], U)
        text = message(read, tmp_path / "a.npz", inputs=["u:2"], outputs=["y"])
        assert "column u:2  does not fit an array of 400 samples; write u:(1 to 2):(1 to 3)" in text
        assert "column y    there is no variable y; it has u, x" in text
        assert "several variables" in message(read, tmp_path / "a.npz", inputs=["1"])

    def test_numpy_refusals(self, tmp_path):
        np.save(tmp_path / "objects.npy", np.array([{}, None], dtype=object), allow_pickle=True)
        np.save(tmp_path / "complex.npy", np.array([1j * U, U]))
        (tmp_path / "cut.npy").write_bytes((tmp_path / "complex.npy").read_bytes()[:200])
        (tmp_path / "text.npz").write_text("no archive")
        np.savez(tmp_path / "lengths.npz", u=U, x=X[:-3])
        np.savez(tmp_path / "objects.npz", u=np.array([{}] * N, dtype=object), x=X)
        assert "u cannot be read" in message(read, tmp_path / "objects.npz", inputs=["u"])
        assert "is no .npy file that can be read" in message(read, tmp_path / "objects.npy")
        assert "complex numbers" in message(read, tmp_path / "complex.npy", inputs=["1"], outputs=["2"])
        assert "cut short" in message(read, tmp_path / "cut.npy")
        assert "is no .npz file" in message(read, tmp_path / "text.npz")
        assert "different numbers of samples: u 400, x 397" in message(
            read, tmp_path / "lengths.npz", inputs=["u"]
        )

    def test_matlab_variables_and_structures(self, tmp_path, table):
        path = tmp_path / "a.mat"
        scipy.io.savemat(path, {"data": {"u": U[:, None], "y": table}, "x": X, "note": "text", "none": []})
        (record,) = read(path, inputs=["data.u"], outputs=["data.y:3"])
        np.testing.assert_array_equal(record.y_um[0], X)
        text = message(read, path, inputs=["data"], outputs=["x"])
        assert "there is no variable data; did you mean data.y? it has data.u, data.y, x" in text

    def test_matlab_7_3(self, tmp_path, table):
        path = tmp_path / "a.mat"
        with h5py.File(path, "w") as file:
            for name, value in (("data/u", U[None]), ("y", table.T)):
                file[name] = value  # MATLAB writes the axes in reverse order
                file[name].attrs["MATLAB_class"] = np.bytes_("double")
            file["note"] = np.frombuffer(b"abc", dtype=np.uint8).astype(np.uint16)
            file["note"].attrs["MATLAB_class"] = np.bytes_("char")
        (record,) = read(path, inputs=["data.u"], outputs=["y:3"])
        np.testing.assert_array_equal(record.u_v[0], U)
        np.testing.assert_array_equal(record.y_um[0], X)
        assert read_array(path, "y").shape == (N, 3)
        assert "it has data.u, y" in message(read, path, inputs=["note"])

    def test_matlab_that_is_none(self, tmp_path):
        (tmp_path / "a.mat").write_text("something else entirely " * 20)
        assert "is no .mat file that can be read" in message(read, tmp_path / "a.mat")

    def test_parquet(self, tmp_path, table):
        arrow = pytest.importorskip("pyarrow", reason="pyarrow is not installed")
        from pyarrow import parquet

        path = tmp_path / "a.parquet"
        names = ["t", "u_x", "x"]
        columns = {name: table[:, k] for k, name in enumerate(names)} | {"note": ["a"] * N}
        parquet.write_table(arrow.table(columns), path)
        (record,) = read(path, time="t", rate_hz=None, outputs=["3"])
        np.testing.assert_array_equal(record.y_um[0], X)
        assert "holds string, not numbers" in message(read, path, outputs=["note"])
        assert "did you mean u_x?" in message(read, path, inputs=["u_y"])
        path.write_text("no parquet")
        assert "is no Parquet file" in message(read, path)

    def test_parquet_without_pyarrow(self, tmp_path, monkeypatch):
        monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
        (tmp_path / "a.parquet").write_bytes(b"PAR1")
        assert "pip install pyarrow" in message(read, tmp_path / "a.parquet")


class TestTime:
    def test_sample_time_from_a_column(self, csv):
        assert read(csv(), time="t", rate_hz=None)[0].sample_time_s == 5e-3

    @pytest.mark.parametrize(("rate", "digits"), [(20000.0, 5), (3000.0, 4), (3000.0, 6), (333.0, 4)])
    def test_rounded_digits_are_no_jitter(self, rate, digits):
        time_s = np.round(np.arange(5000) / rate, digits)
        assert time_mistakes("t", time_s, np.arange(5000)) == []
        assert sample_time(time_s) == 1.0 / rate

    def test_rate_that_is_no_whole_number(self):
        assert sample_time(0.0123456 * np.arange(100)) == pytest.approx(0.0123456, rel=1e-12)

    def test_gap(self, csv):
        def change(lines):
            del lines[101:111]

        text = message(read, csv(change), time="t", rate_hz=None)
        assert "column t, rows 101 to 102  gap of 0.055 s, about 10 missing samples" in text.replace(
            ": ", "  "
        )

    def test_step_back(self, csv):
        def change(lines):
            lines[60] = lines[10]

        text = message(read, csv(change), time="t", rate_hz=None)
        assert "rows 60 to 61" in text
        assert "time does not increase (0.29 s, then 0.045 s; 1 such steps)" in text

    def test_jitter(self):
        rng = np.random.default_rng(1)
        (mistake,) = time_mistakes("t", TIME + 1e-3 * rng.uniform(-1, 1, N), np.arange(N))
        assert "non-uniform time: steps from" in mistake.what
        assert "resample" in mistake.what

    def test_mistakes_of_time_and_signal_come_together(self, csv):
        def change(lines):
            lines[60] = lines[10]
            lines[70] = lines[70].replace(",", ",bad", 1)

        text = message(read, csv(change), time="t", rate_hz=None)
        assert "time does not increase" in text
        assert "'bad" in text


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
        assert text.count("try --output-scale 1e6 if the file is in m") == 3
        assert "experiment 3, column" in text

    def test_paired_arrays_that_do_not_fit(self, tmp_path):
        np.save(tmp_path / "u.npy", np.outer(U, [1.0, 2.0]))
        np.save(tmp_path / "y.npy", np.outer(X, [1.0, 2.0, 3.0]))
        pair = tmp_path / "u.npy", tmp_path / "y.npy"
        assert len(read_paired_records(*pair, rate_hz=200.0)) == 1
        assert "2 experiments, 1 periods, 400 samples against 3 experiments" in message(
            read_paired_records, *pair, axes=("sample", "experiment"), rate_hz=200.0
        )
        assert "shape (400, 2), but the axes are sample" in message(
            read_paired_records, *pair, axes=("sample",), rate_hz=200.0
        )
        assert "name sample" in message(read_paired_records, *pair, axes=("time",), rate_hz=200.0)
        assert "is no file of arrays" in message(read_paired_records, __file__, pair[1], rate_hz=200.0)


class TestPreparation:
    def test_offset_and_dead_start_under_noise(self):
        rng = np.random.default_rng(2)
        u = np.concatenate([np.zeros(80), U]) + 3.0
        x = np.concatenate([np.zeros(80), X]) - 95.0
        record = Record([u], [x + 0.04 * rng.standard_normal(x.size)], 5e-3)
        prepared = prepare(record)
        assert prepared.at_rest
        assert prepared.dead_start_samples == 80
        assert prepared.offset_v.tolist() == [3.0]
        assert prepared.offset_um[0] == pytest.approx(-95.0, abs=0.015)
        np.testing.assert_allclose(prepared.record.u_v[0], U, atol=1e-14)
        assert prepared.record.rows[0] == 81

    def test_dead_start_of_a_noisy_voltage(self):
        rng = np.random.default_rng(3)
        u = np.concatenate([np.zeros(80), U]) + 0.005 * rng.standard_normal(N + 80)
        assert prepare(Record([u], [u], 5e-3)).dead_start_samples == pytest.approx(80, abs=3)

    def test_without_dead_start_offsets_are_the_middle(self):
        late = slice(30, None)
        prepared = prepare(Record([U[late] + 2.0, 0 * U[late] + 0.5], [X[late] - 50.0], 5e-3))
        assert not prepared.at_rest
        assert prepared.offset_v == pytest.approx([2.0, 0.5])
        assert prepared.offset_um == pytest.approx([-50.0], abs=1e-9)
        assert prepared.dead_start_samples == 0

    @pytest.mark.parametrize("delay", [0, 1, 4])
    @pytest.mark.parametrize("noise", [0.0, 0.04])
    def test_delay_is_told_from_hysteresis(self, delay, noise):
        """The hysteresis alone lags by eight degrees, more than four samples of 200 a period."""
        rng = np.random.default_rng(4)
        u = np.concatenate([U, 0.7 * U, 0.4 * U])
        x = np.array([4.0, 0.5, 0.8, 1.2]) @ plays(u, THRESHOLDS)
        late = np.concatenate([np.zeros(delay), x[: len(x) - delay]])
        record = Record([u], [late + noise * rng.standard_normal(x.size)], 5e-3)
        assert np.degrees(lag_rad(record)[0, 0]) > 4.0 + 1.8 * delay
        assert estimate_delay(record, 6) == delay
        prepared = prepare(record, max_delay_samples=6)
        assert prepared.delay_samples == delay
        np.testing.assert_allclose(
            prepared.record.y_um[0], x[: len(x) - delay] - prepared.offset_um, atol=5 * noise + 1e-9
        )

    def test_delay_needs_samples(self):
        assert "too few" in message(estimate_delay, Record([U], [X], 5e-3), 100)

    @pytest.mark.parametrize("gain", [1.0, -1.0])
    def test_swapped_columns_are_told_by_the_direction_of_the_loop(self, gain):
        right = Record([U], [gain * X], 5e-3, ("ux",), ("x",))
        assert leads(right) == ()
        refuse_swapped(right)
        if gain > 0:
            swapped = Record([X], [U], 5e-3, ("x",), ("ux",), "loop.csv")
            assert leads(swapped) == ((0, 0),)
            text = message(refuse_swapped, swapped)
            assert text.startswith("loop.csv: 1 mistake\n  column ux, rows 1 to 400  leads x by ")
            assert "swapped?" in text

    def test_lag_is_the_phase_of_a_sine(self):
        n = np.arange(4000)
        for degrees in (-20.0, 0.0, 35.0):
            y = np.sin(2.0 * np.pi * n / 200 - np.radians(degrees))
            lag = lag_rad(Record([np.sin(2.0 * np.pi * n / 200)], [y], 5e-3))
            assert np.degrees(lag[0, 0]) == pytest.approx(degrees, abs=1e-6)

    def test_a_lag_above_resonance_is_not_taken_for_a_lead(self):
        n = np.arange(4000)
        for degrees in (100.0, 150.0, 178.0, 290.0):
            y = np.sin(2.0 * np.pi * n / 200 - np.radians(degrees))
            assert leads(Record([np.sin(2.0 * np.pi * n / 200)], [y], 5e-3)) == ()


class TestMeasured:
    @pytest.fixture
    def data(self):
        if not DATA.is_dir():
            pytest.skip("measured records are not beside the repository")
        return DATA

    def test_micromanipulator(self, data):
        folder = data / "dbo_piezo_micromanipulator"
        for name, samples in (("Model_Vi_Do.dat", 8027), ("Test_Vi_Do_Di.dat", 14155)):
            (record,) = read_records([folder / name], inputs=["1"], outputs=["5"], rate_hz=200.0)
            assert record.samples == samples
            assert leads(record) == ()
            assert leads(Record(record.y_um, record.u_v, 5e-3)) == ((0, 0),)
            assert estimate_delay(record, 8) == 3

    def test_micromanipulators_unused_columns(self, data):
        path = data / "dbo_piezo_micromanipulator" / "Model_Vi_Do.dat"
        text = message(read_records, [path], inputs=["2"], outputs=["6"], rate_hz=200.0)
        assert "column 2, rows 1 to 8027  constant input, always 0" in text
        assert "column 6, rows 1 to 8027  constant output, always -317.205767" in text

    @pytest.mark.parametrize(("name", "count"), [("train", 6), ("test", 3)])
    def test_mirror(self, data, name, count):
        folder = data / "cubespec_fsm"
        records = read_paired_records(
            folder / f"u_100mV_{name}.npy",
            folder / f"y_100mV_{name}.npy",
            axes=("sample", "channel", "experiment", "period"),
            rate_hz=6400.0,
            output_scale=1e6,
        )
        assert len(records) == count
        for record in records:
            assert record.u_v.shape == record.y_um.shape == (3, 16384)
            assert record.period_samples == 8192
            np.testing.assert_allclose(record.u_v.std(axis=1), 0.099, rtol=0.02)
        assert driven_inputs(records[0]) == (0, 1, 2)
        assert leads(records[0]) == ()

    def test_magnetic_loops_stand_side_by_side(self, data):
        folder = data / "ja_magnetic_loops"
        records = read_paired_records(
            folder / "10_APPA_H_M130_27s.mat",
            folder / "10_APPA_B_M130_27s.mat",
            axes=("sample", "experiment"),
            rate_hz=1.0,
        )
        assert [record.u_v.shape for record in records] == [(1, 256)] * 3
        assert [leads(record) for record in records] == [()] * 3
        columns = read_columns(folder / "10_APPA_H_M130_27s.mat", ["HmeasT:2"])
        np.testing.assert_array_equal(columns.values[0], records[1].u_v[0])


def test_message_survives_json(csv):
    """Programs get the same mistakes as people."""
    with pytest.raises(InputError) as caught:
        read(csv(), inputs=["nothing"])
    assert json.loads(json.dumps(caught.value.mistakes)) == [
        list(mistake) for mistake in caught.value.mistakes
    ]


def test_jitter_is_no_gap(tmp_path):
    step = 50e-6
    time_s = step * np.arange(4000) + 0.2 * step * np.random.default_rng(0).standard_normal(4000)
    u = np.sin(2.0 * np.pi * 50.0 * time_s)
    path, table = tmp_path / "jitter.csv", np.column_stack([np.sort(time_s), u, 5.0 * u])
    np.savetxt(path, table, delimiter=",", header="t,u,y", comments="")
    with pytest.raises(InputError, match="non-uniform time") as caught:
        read_records([path], inputs=["u"], outputs=["y"], time="t")
    assert "missing" not in str(caught.value)


@pytest.mark.parametrize("name", ["time_ms", "t [us]", "Time (ms)"])
def test_a_time_that_names_another_unit_is_refused(tmp_path, name):
    path = tmp_path / "ms.csv"
    u = np.sin(0.1 * np.arange(200))
    table = np.column_stack([np.arange(200), u, u])
    np.savetxt(path, table, delimiter=",", header=f"{name},u,y", comments="")
    with pytest.raises(InputError, match="another unit than s; give --rate"):
        read_records([path], inputs=["u"], outputs=["y"], time=name)
