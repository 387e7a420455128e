"""Records out of files: formats, columns, times, and what is refused in them."""

from __future__ import annotations

import gzip
import json
import sys

import h5py
import nptdms
import numpy as np
import openpyxl
import pandas as pd
import pytest
import scipy.io
from record_cases import TIME, N, U, X, message, read, table_text

from hammerstein.errors import InputError
from hammerstein.records.checks import sample_time, time_mistakes
from hammerstein.records.readers import read_array
from hammerstein.records.reading import read_records


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

        assert "is there an unclosed quotation mark?" in message(read, csv(leave_open))

    def test_preamble_and_row_of_units(self, tmp_path, table):
        path = tmp_path / "scope.csv"
        head = "Device,OFV 5000\nSampling rate,200\n\nt,u_x,x\ns,V,um\n"
        path.write_text(head + table_text(table))
        (record,) = read(path, time="t", rate_hz=None)
        assert record.rows[0] == 6
        assert record.outputs == ("x",)

    def test_a_comment_below_the_header_is_no_header(self, tmp_path, table):
        """It has as many words as there are columns; a header that is a comment itself is still read."""
        path, said = tmp_path / "wave.csv", "# untried on a device: range 10 V, rate 20 kHz, one channel\n"
        for mark in ("", "# "):
            path.write_text(f"# a title\n{mark}t,u_x,x\n" + (said if not mark else "") + table_text(table))
            (record,) = read(path, time="t", rate_hz=None)
            assert (record.inputs, record.outputs) == (("u_x",), ("x",))

    def test_a_column_of_text_that_is_not_wanted(self, tmp_path, table):
        path = tmp_path / "log.csv"
        lines = table_text(table).splitlines()
        path.write_text("when,t,u_x,x\n" + "\n".join(f"12:00:{k:03d},{line}" for k, line in enumerate(lines)))
        (record,) = read(path)
        np.testing.assert_allclose(record.u_v[0], U, atol=1e-9)
        said = "'12:00:000' and others: this column has text in every row; name another column"
        assert said in message(read, path, outputs=["when"])

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
        assert "column u_x, row 11  has no finite number" in text
        assert "column x, row 21    has no finite number" in text
        assert "column u_x, row 31  has no finite number" in text

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

        assert "is 2 times in the header; give its number, 2 and 3" in message(
            read, csv(change), inputs=["t"], outputs=["x"]
        )

    def test_one_column_named_twice(self, csv):
        assert "inputs (--inputs) and outputs (--outputs)  u_x is named twice" in message(
            read, csv(), outputs=["u_x"]
        )
        assert "named twice, by name and by number" in message(read, csv(), outputs=["2"])


def european(value):
    """1.234,5678 with points between groups of digits."""
    return f"{value:,.4f}".translate(str.maketrans(",.", ".,"))


class TestNumbersAsPeopleWriteThem:
    wide = np.column_stack([TIME, 150.0 * U, 40.0 * X])

    @pytest.mark.parametrize(
        ("separator", "quote", "written"),
        [
            (";", "", european),
            ("\t", "", european),
            (" ", "", european),
            (",", '"', european),
            (",", '"', lambda value: f"{value:.4f}".replace(".", ",")),
            (";", '"', lambda value: f"{value:.4f}".replace(".", ",")),
            (";", "", lambda value: f"{value:,.4f}"),
            (",", '"', lambda value: f"{value:,.4f}"),
        ],
    )
    def test_decimal_commas_and_groups_of_digits(self, tmp_path, separator, quote, written):
        path = tmp_path / "loop.csv"
        rows = [separator.join(f"{quote}{written(v)}{quote}" for v in row) for row in self.wide]
        path.write_text("\n".join([separator.join(["t", "u_x", "x"]), *rows]) + "\n")
        (record,) = read(path)
        np.testing.assert_allclose(record.u_v[0], 150.0 * U, atol=1e-4)
        np.testing.assert_allclose(record.y_um[0], 40.0 * X, atol=1e-4)

    def test_a_point_in_the_wrong_place_is_no_group(self, tmp_path):
        path = tmp_path / "loop.csv"
        rows = [";".join(european(v) for v in row) for row in self.wide]
        rows[5] = rows[5].rpartition(";")[0] + ";12.34,5"
        path.write_text("\n".join(["t;u_x;x", *rows]) + "\n")
        assert "row 7  '12.34,5' is text in a column of numbers" in message(read, path)

    def test_three_decimals_are_no_group(self, tmp_path, table):
        path = tmp_path / "loop.csv"
        rows = [";".join(f"{v:.3f}".replace(".", ",") for v in row) for row in 1.0 + table]
        path.write_text("\n".join(["t;u_x;x", *rows]) + "\n")
        np.testing.assert_allclose(read(path)[0].u_v[0], 1.0 + U, atol=1e-3)

    @pytest.mark.parametrize(
        "head",
        [
            "Stage 5, measured on 12.3.2024\nt,u_x,x\n",
            "t,u_x,x\nStage 5 as measured\n",
            "Stage 5\n\nt,u_x,x\nsec,Volt,micron\n",
            '"Stage 5"\nRate,200\nt,u_x,x\n',
        ],
    )
    def test_title_rows(self, tmp_path, table, head):
        path = tmp_path / "loop.csv"
        path.write_text(head + table_text(table))
        np.testing.assert_allclose(read(path)[0].u_v[0], U, atol=1e-9)

    def test_units_behind_names_that_blanks_part(self, tmp_path, table):
        path = tmp_path / "loop.txt"
        path.write_text("t [s] u [mV] x [um]\n" + table_text(table, " "))
        (record,) = read(path, inputs=["u [mV]"], outputs=["x [um]"])
        np.testing.assert_allclose(record.u_v[0], 1e-3 * U, atol=1e-9)


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
            ("prose.txt", "has no line of numbers"),
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

    def test_units_tell_what_the_columns_are(self, tmp_path):
        file = tmp_path / "a.csv"
        header = ("Zeit [ms]", "Spannung [mV]", "Weg [nm]")
        for names in (header, header[::-1]):
            columns = dict(zip(header, (np.arange(N) * 5.0, 1e3 * U, 1e3 * X), strict=True))
            pd.DataFrame(columns)[list(names)].to_csv(file, index=False)
            (record,) = read_records([file])
            assert (record.inputs, record.outputs) == (("Spannung",), ("Weg",))
            assert record.sample_time_s == pytest.approx(5e-3, rel=1e-12)
            np.testing.assert_allclose(record.u_v[0], U, rtol=1e-12)
            np.testing.assert_allclose(record.y_um[0], X, rtol=1e-12)
        (record,) = read_records([file], inputs=["2"], rate_hz=200.0)
        assert record.outputs == ("Weg",)

    def test_columns_without_units_are_asked_for(self, csv):
        text = message(read_records, [csv()], rate_hz=200.0)
        assert text.count("has a unit of") == 2
        assert "name the columns: it has 1 t, 2 u_x, 3 x" in text
        assert "give one of them" in message(read_records, [csv()], inputs=["u_x"], outputs=["x"])

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
        assert "must be 1e-4 to 1e9" in message(read, csv(), rate_hz=-5.0)

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
        assert "column u:2  does not fit an array of 400 samples; write u:1:1 to u:2:3" in text
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
        assert "cannot be read as a .npy file" in message(read, tmp_path / "objects.npy")
        assert "complex numbers" in message(read, tmp_path / "complex.npy", inputs=["1"], outputs=["2"])
        assert "cut short" in message(read, tmp_path / "cut.npy")
        assert "cannot be read as a .npz file" in message(read, tmp_path / "text.npz")
        scipy.io.savemat(tmp_path / "whole.mat", {"u": U, "x": X})
        (tmp_path / "cut.mat").write_bytes((tmp_path / "whole.mat").read_bytes()[:400])
        assert message(read, tmp_path / "cut.mat").count("cut short") == 1
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

    def test_arrays_of_structures_are_read_by_path(self, tmp_path):
        path = tmp_path / "desk.mat"
        signal = np.dtype([("Name", object), ("Data", object)])
        y = np.array([[("u", U), ("v", 2 * U), ("x", X)]], dtype=signal)
        scipy.io.savemat(path, {"run7": {"X": {"Data": TIME}, "Y": y}})
        for u, x in (
            ("Y.1.Data", "Y.3.Data"),
            ("Y(1).Data", "Y(3).Data"),
            ("run7.Y.1.Data", "run7.Y(3).Data"),
        ):
            (record,) = read(path, inputs=[u], outputs=[x])
            np.testing.assert_array_equal(record.u_v[0], U)
            np.testing.assert_array_equal(record.y_um[0], X)
        assert read(path, inputs=["Y.1.Data"], outputs=["Y.3.Data"], time="X.Data", rate_hz=None)
        text = message(read, path, inputs=["Z.Data"], outputs=["Y.3.Data"])
        assert "it has run7.X.Data, run7.Y.1.Data, run7.Y.2.Data, run7.Y.3.Data" in text

    def test_every_path_is_listed(self, tmp_path):
        path = tmp_path / "many.mat"
        scipy.io.savemat(path, {f"signal_{k}": U for k in range(60)})
        text = message(read, path, inputs=["u"], outputs=["signal_1"])
        assert all(f"signal_{k}" in text for k in range(60))

    def test_arrays_of_structures_of_matlab_7_3(self, tmp_path):
        path = tmp_path / "desk73.mat"
        with h5py.File(path, "w") as file:
            group = file.create_group("Y")
            places = []
            for k, value in enumerate((U, X)):
                place = file.create_dataset(f"#refs#/{k}", data=value[:, None])
                place.attrs["MATLAB_class"] = np.bytes_("double")
                places.append(place.ref)
            group.create_dataset("Data", data=np.array(places, dtype=h5py.ref_dtype)[:, None])
        (record,) = read(path, inputs=["Y(1).Data"], outputs=["Y.2.Data"])
        np.testing.assert_array_equal(record.y_um[0], X)

    def test_matlab_that_is_none(self, tmp_path):
        (tmp_path / "a.mat").write_text("something else entirely " * 20)
        assert "cannot be read as a .mat file" in message(read, tmp_path / "a.mat")

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
        assert "cannot be read as a Parquet file" in message(read, path)

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
        assert "column t, rows 101 to 102  gap of 55 ms, about 10 missing samples" in text.replace(": ", "  ")

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


def test_a_matlab_file_of_version_7_3_without_its_library_is_told_what_to_install(tmp_path, monkeypatch):
    path = tmp_path / "a.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["u"] = np.arange(5.0)
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(512) + path.read_bytes()[512:])
    monkeypatch.setitem(sys.modules, "h5py", None)
    told = message(read, path, inputs=["u:1"], outputs=["u:2"])
    assert "version 7.3" in told
    assert "hammerstein-control[matlab]" in told


class TestLoggers:
    """Files of data loggers: a workbook, TDMS and plain HDF5, by the names in them."""

    def test_a_workbook_with_title_units_and_empty_cells(self, tmp_path):
        book = openpyxl.Workbook()
        for row in (["Measured on stage 7"], [], ["t", "u_x", "x"], *np.stack([TIME, U, X], axis=1).tolist()):
            book.active.append(row)
        book.create_sheet("empty")
        book.save(tmp_path / "a.xlsx")
        (record,) = read(tmp_path / "a.xlsx")
        np.testing.assert_allclose(record.u_v[0], U, atol=1e-13)
        np.testing.assert_allclose(record.y_um[0], X, atol=1e-13)
        assert "did you mean u_x" in message(read, tmp_path / "a.xlsx", inputs=["u_y"])
        book.active.cell(10, 2).value = None
        book.save(tmp_path / "a.xlsx")
        assert "u_x, row 7  has no finite number" in message(read, tmp_path / "a.xlsx")

    def test_sheets_are_named_where_there_are_several(self, tmp_path):
        book = openpyxl.Workbook()
        for sheet, name, values in ((book.active, "u_x", U), (book.create_sheet("second"), "x", X)):
            for cell in (name, *values.tolist()):
                sheet.append([cell])
        book.save(tmp_path / "a.xlsx")
        (record,) = read(tmp_path / "a.xlsx", inputs=["Sheet.u_x"], outputs=["second.x"])
        np.testing.assert_allclose(record.y_um[0], X, atol=1e-13)

    def test_tdms(self, tmp_path):
        with nptdms.TdmsWriter(tmp_path / "a.tdms") as file:
            file.write_segment([nptdms.ChannelObject("log", n, v) for n, v in (("u_x", U), ("x", X))])
        (record,) = read(tmp_path / "a.tdms")
        np.testing.assert_array_equal(record.u_v[0], U)
        np.testing.assert_array_equal(record.y_um[0], X)
        assert "it has u_x, x" in message(read, tmp_path / "a.tdms", inputs=["v"])

    @pytest.mark.parametrize(("clock", "rate_hz"), [(False, 1e4), (True, 2e4)])
    def test_waveforms_of_tdms_bring_their_clock(self, tmp_path, clock, rate_hz):
        """A channel of time goes before the increment, which some loggers leave at its default."""
        names = [("u_x", U), ("x", X), *[("Time", np.arange(len(U)) / 2e4)] * clock]
        with nptdms.TdmsWriter(tmp_path / "a.tdms") as file:
            wave = {"wf_increment": 1e-4}
            file.write_segment([nptdms.ChannelObject("log", n, v, wave) for n, v in names])
        (record,) = read_records(
            [tmp_path / "a.tdms"], inputs=["u_x"], outputs=["x"], time="Time" if clock else None
        )
        assert record.rate_hz == pytest.approx(rate_hz)
        if not clock:
            told = message(read_records, [tmp_path / "a.tdms"], inputs=["u_x"], outputs=["x"], rate_hz=3e4)
            assert "which is 10000 Hz" in told

    def test_plain_hdf5_by_path(self, tmp_path):
        with h5py.File(tmp_path / "a.h5", "w") as file:
            file["run/volts"] = U
            file["run/both"] = np.stack([X, U], axis=1)
            file["note"] = "text"
        for inputs, outputs in ((["run.volts"], ["run.both:1"]), (["/run/volts"], ["run/both:1"])):
            (record,) = read(tmp_path / "a.h5", inputs=inputs, outputs=outputs)
            np.testing.assert_array_equal(record.u_v[0], U)

    def test_units_that_a_file_states_are_used(self, tmp_path):
        """Attributes of TDMS channels and HDF5 arrays, and a row of units in a workbook: mV, nm and ms."""
        stated = {"clock": ("ms", 1e3 * TIME), "drive": ("mV", 1e3 * U), "sensor": ("nm", 1e3 * X)}
        with nptdms.TdmsWriter(tmp_path / "a.tdms") as file:
            channels = [
                nptdms.ChannelObject("log", name, values, {"unit_string": unit})
                for name, (unit, values) in stated.items()
            ]
            file.write_segment(channels)
        with h5py.File(tmp_path / "a.h5", "w") as file:
            for name, (unit, values) in stated.items():
                file[name] = values
                file[name].attrs["units"] = unit
        book = openpyxl.Workbook()
        for row in (list(stated), [unit for unit, _ in stated.values()]):
            book.active.append(row)
        for row in np.stack([values for _, values in stated.values()], axis=1).tolist():
            book.active.append(row)
        book.save(tmp_path / "a.xlsx")
        for name in ("a.tdms", "a.h5", "a.xlsx"):
            (record,) = read_records([tmp_path / name])
            np.testing.assert_allclose(record.u_v[0], U, atol=1e-12, err_msg=name)
            np.testing.assert_allclose(record.y_um[0], X, atol=1e-12, err_msg=name)
            assert record.sample_time_s == pytest.approx(TIME[1] - TIME[0], rel=1e-9)
            (record,) = read_records([tmp_path / name], output_scale=2e-3)
            np.testing.assert_allclose(record.y_um[0], 2.0 * X, atol=1e-12, err_msg=name)

    @pytest.mark.parametrize(
        ("name", "library", "extra"),
        [("a.xlsx", "openpyxl", "excel"), ("a.tdms", "nptdms", "tdms"), ("a.h5", "h5py", "matlab")],
    )
    def test_the_message_names_the_extra(self, tmp_path, monkeypatch, name, library, extra):
        (tmp_path / name).write_bytes(b"PK")
        monkeypatch.setitem(sys.modules, library, None)
        assert f"hammerstein-control[{extra}]" in message(read, tmp_path / name)

    @pytest.mark.parametrize("name", ["a.xlsx", "a.tdms", "a.h5"])
    def test_a_damaged_file_is_one_mistake(self, tmp_path, name):
        (tmp_path / name).write_bytes(b"TDSm" + bytes(range(200)))
        text = message(read, tmp_path / name)
        assert "cannot be read" in text or "no array of numbers" in text


def test_a_time_column_has_the_limits_of_a_rate(tmp_path):
    """Seconds under a header that says microseconds: 20 kHz became 20 GHz, and the fit an internal error."""
    path = tmp_path / "r.csv"
    rows = "".join(f"{k * 5e-5:.5f},{k % 7},{k % 5}\n" for k in range(200))
    path.write_text("t [us],u [V],x [um]\n" + rows)
    with pytest.raises(InputError, match=r"a rate of 2e\+10 Hz; it must be 1e-4 to 1e9. Is its"):
        read_records([path], inputs=["u"], outputs=["x"], time="t")


@pytest.mark.parametrize("name", ["model.json", "scenario.toml"])
def test_a_model_given_as_a_record_is_told_by_its_name(tmp_path, name):
    (tmp_path / name).write_text("[1.0, 2.0]\n[3.0, 4.0]\n" * 50)
    assert "such as a model or a scenario; give CSV" in message(read, tmp_path / name)


def test_a_lone_header_is_shown(tmp_path):
    (tmp_path / "a.csv").write_text("time_s,u_x,x\n")
    text = message(read, tmp_path / "a.csv")
    assert "has one line and no numbers below it: time_s,u_x,x; export the samples, too" in text


@pytest.mark.parametrize("cut", [False, True])
def test_a_packed_table_is_called_packed_and_a_cut_one_cut(tmp_path, cut):
    packed = gzip.compress("".join(f"{k},{k % 7}\n" for k in range(5000)).encode())
    path = tmp_path / "a.csv.gz"
    path.write_bytes(packed[: len(packed) // 2] if cut else packed)
    text = message(read, path)
    assert "is compressed with gzip" in text
    assert ("was cut short" in text) is cut
