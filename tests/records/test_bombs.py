"""Files that hold more than they seem to, or what no record holds, are refused before their size is felt."""

import gzip
import json
import subprocess
import sys
import zlib

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from hammerstein.blocks.instruments import intervals
from hammerstein.commands.cli import main
from hammerstein.errors import InputError
from hammerstein.records import checks
from hammerstein.records.file_formats import COMPRESSED
from hammerstein.records.readers import array_columns, arrays_in


def element(kind, data):
    padding = b"" if kind == COMPRESSED else bytes(-len(data) % 8)
    return np.array([kind, len(data)], "<u4").tobytes() + data + padding


def matlab_header(mark=b"IM"):
    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01" + mark


@pytest.mark.parametrize("mark", [b"XX", b"\0\0", b"II", b"MM", b"im", b"\xff\xff"])
def test_a_matlab_file_of_no_known_byte_order_is_left_to_no_compiled_reader(tmp_path, monkeypatch, mark):
    def dies(*_, **__):
        raise AssertionError("SciPy's reader would be called")

    monkeypatch.setattr("scipy.io.loadmat", dies)
    path = tmp_path / "a.mat"
    savemat(path, {"u": np.arange(9.0)})
    data = bytearray(path.read_bytes())
    data[126:128] = mark
    path.write_bytes(data)
    with pytest.raises(InputError, match="neither the byte-order mark"):
        array_columns(path, ["u"])


def test_version_4_is_read_by_scipy_and_its_lengths_are_checked(tmp_path):
    path = tmp_path / "a.mat"
    savemat(path, {"u": np.arange(9.0)}, format="4")
    assert array_columns(path, ["u"])[0].tolist() == [list(range(9))]
    data = bytearray(path.read_bytes())
    data[4:8] = np.array([2_000_000_000], "<i4").tobytes()
    path.write_bytes(data)
    with pytest.raises(InputError, match="declares more numbers than it contains"):
        array_columns(path, ["u"])


def test_all_that_comes_out_of_a_matlab_file_has_a_limit(tmp_path, monkeypatch):
    """Twenty variables of a byte a number, each below the limit, and all of them beyond it."""
    monkeypatch.setattr(checks, "MOST_NUMBERS", 100_000)
    count = 50_000
    parts = [element(6, np.array([6, 0], "<u4").tobytes()), element(5, np.array([1, count], "<i4").tobytes())]
    small = element(2, bytes(count))
    variables = [
        element(COMPRESSED, zlib.compress(element(14, b"".join([*parts, element(1, name), small]))))
        for name in (b"a%02d" % n for n in range(20))
    ]
    path = tmp_path / "a.mat"
    path.write_bytes(matlab_header() + b"".join(variables[:1]))
    assert array_columns(path, ["a00"])[0].shape == (1, count)
    path.write_bytes(matlab_header() + b"".join(variables))
    with pytest.raises(InputError, match="decompresses to more than"):
        array_columns(path, ["a00"])


def test_objects_are_visited_once_however_many_links_lead_to_them(tmp_path):
    path = tmp_path / "a.mat"
    with h5py.File(path, "w") as file:
        group = file.create_group("g")
        for _ in range(45):
            inner = group.create_group("a")
            group["b"] = inner
            group = inner
        group["u"] = np.arange(9.0)
        file["again"] = file["g"]
        file["own"] = np.arange(5.0)
        file["same"] = file["own"]
    assert {"own", "same"} < {name for name, _ in arrays_in(path)}
    assert len(list(arrays_in(path))) == 3


@pytest.mark.parametrize("how", ["external storage", "external link", "virtual"])
def test_no_other_file_is_read_through_a_record(tmp_path, how):
    secret, path = tmp_path / "secret", tmp_path / "a.mat"
    secret.write_bytes(bytes(range(72)))
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["u"] = np.arange(9.0)
    with h5py.File(path, "w") as file:
        if how == "external storage":
            file.create_dataset("u", (9,), "f8", external=[(str(secret), 0, 72)])
        elif how == "external link":
            file["u"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "u")
        else:
            layout = h5py.VirtualLayout((9,), "f8")
            layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "u", (9,))
            file.create_virtual_dataset("u", layout)
    with pytest.raises(InputError, match="is in another file"):
        array_columns(path, ["u"])


def test_wide_texts_of_an_npz_file_are_not_unpacked(tmp_path, monkeypatch):
    path = tmp_path / "a.npz"
    np.savez_compressed(path, u=np.zeros(1000, "U10000"))
    monkeypatch.setattr(checks, "MOST_NUMBERS", 1_000_000)
    with pytest.raises(InputError, match="million numbers"):
        array_columns(path, ["u"])


@pytest.mark.skipif(sys.platform != "linux", reason="limits of address space")
def test_one_long_string_takes_no_more_than_a_few_times_its_length(tmp_path):
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"a": "x" * 20_000_000 + '\\"' * 1000}))
    code = (
        "import resource; from pathlib import Path; from hammerstein.files import read_limited;"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss;"
        f"read_limited(Path({str(path)!r}), 'file');"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)"
    )
    grown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert int(grown) < 300_000  # kB


@pytest.mark.parametrize(("name", "packed"), [("x.csv.gz", False), ("x.gz", False), ("x.csv.gz", True)])
def test_the_name_of_a_text_file_says_nothing_of_packing(tmp_path, capsys, name, packed):
    text = "t,u,y\n" + "".join(f"{k},{k % 7},{k % 5}\n" for k in range(50))
    path = tmp_path / name
    path.write_bytes(gzip.compress(text.encode()) if packed else text.encode())
    with pytest.raises(SystemExit) as end:
        main(["show", str(path)])
    told = capsys.readouterr()
    assert end.value.code == (2 if packed else 0)
    assert "output cannot be written" not in told.err
    assert ("compressed with gzip" in told.err) == packed


def test_a_whole_number_of_hundreds_of_digits_is_a_mistake_in_a_row(tmp_path, capsys):
    path = tmp_path / "a.csv"
    path.write_text("t,u,y\n0,1,2\n1,1" + "0" * 400 + ",3\n2,x,4\n3,4,5\n")
    with pytest.raises(SystemExit) as end:
        main(["loops", str(path), "--inputs", "u", "--outputs", "y", "--rate", "1000"])
    assert end.value.code == 2
    assert "rows 3 to 4" in capsys.readouterr().err


@pytest.mark.parametrize("value", [10**400, [-(10**400), 1]])
def test_so_is_one_in_place_of_a_voltage(value):
    with pytest.raises(ValueError, match=r"V at each end|positive number"):
        intervals(value)


def test_nor_is_one_in_a_path(tmp_path, capsys):
    path = tmp_path / "a.csv"
    path.write_text("time_s,x,y\n0,0,0\n5e-5,x,1\n1e-4,1" + "0" * 400 + ",0\n")
    with pytest.raises(SystemExit) as end:
        main(["compensate", "duo_bimorph_static", str(path), "--out", str(tmp_path / "out.csv")])
    assert end.value.code == 2
    assert "row" in capsys.readouterr().err


def test_a_model_of_one_long_text_is_refused_by_its_size(tmp_path, capsys):
    path = tmp_path / "a.json"
    path.write_text('{"name": "' + "a" * 6_000_000 + '"}')
    with pytest.raises(SystemExit) as end:
        main(["export", str(path), "--out", str(tmp_path / "out")])
    assert end.value.code == 2
    assert "has 6 MB, too large for a model file" in capsys.readouterr().err
