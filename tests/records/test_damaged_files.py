"""Files of arrays that are damaged, or that unfold to more than a machine holds, end in one message."""

import random
import zipfile

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from hammerstein.errors import InputError
from hammerstein.records.file_formats import UNREAD, read_matlab_v5
from hammerstein.records.readers import array_columns

CONTENT = {
    "u": np.random.default_rng(1).normal(size=(200, 2)),
    "cube": np.arange(24.0).reshape(2, 3, 4),
    "whole": np.arange(6, dtype=np.int16).reshape(2, 3),
    "complex": np.array([[1.0 + 2.0j, 3.0]]),
    "text": "hällo",
    "cell": np.array([np.eye(2), "x", np.arange(3.0)], dtype=object),
    "data": {"y": np.linspace(0.0, 1.0, 200), "deep": {"n": "name", "x": np.arange(3.0)}},
    "empty": np.zeros((0, 0)),
    "single": np.ones((2, 2), np.float32),
}


def _same(ours, theirs):
    if theirs.dtype.kind == "U":  # a text, which is no signal
        assert ours is UNREAD
        return
    assert ours.shape == theirs.shape
    assert ours.dtype.names == theirs.dtype.names
    for name in theirs.dtype.names or ():
        for mine, other in zip(ours[name].flat, theirs[name].flat, strict=True):
            _same(mine, other)
    if theirs.dtype == object:
        for mine, other in zip(ours.flat, theirs.flat, strict=True):
            _same(mine, other)
    elif not theirs.dtype.names:
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("packed", [False, True])
def test_good_files_give_what_scipy_gives(tmp_path, packed):
    savemat(tmp_path / "a.mat", CONTENT, do_compression=packed)
    ours, theirs = read_matlab_v5(tmp_path / "a.mat", 10**9), loadmat(tmp_path / "a.mat")
    assert set(ours) == {name for name in theirs if name[:2] != "__" and name != "text"}
    for name, value in ours.items():
        _same(value, theirs[name])


@pytest.mark.parametrize("packed", [False, True])
def test_no_flipped_byte_does_more_than_a_message(tmp_path, packed):
    savemat(tmp_path / "a.mat", CONTENT, do_compression=packed)
    whole, draw = (tmp_path / "a.mat").read_bytes(), random.Random(7)
    path, told = tmp_path / "b.mat", []
    for _ in range(400):
        damaged = bytearray(whole[: draw.choice([len(whole), draw.randrange(len(whole))])])
        for _ in range(draw.choice([1, 2, 8])):
            damaged[draw.randrange(len(damaged))] = draw.randrange(256)
        path.write_bytes(damaged)
        try:
            array_columns(path, ["u:1", "data.y"])
        except InputError as error:
            told.append(str(error))
    assert len(told) > 50
    assert all(str(path) in text and " object at " not in text for text in told)


def test_a_bomb_is_refused_by_what_it_declares(tmp_path):
    """300 million zeros in an .npz file once took 4.9 GB and 47 s."""
    path = tmp_path / "bomb.npz"
    header = np.lib.format.header_data_from_array_1_0(np.zeros(1)) | {"shape": (300_000_000, 1)}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("u.npy", "w") as file:
        np.lib.format.write_array_header_1_0(file, header)
        file.write(bytes(1_000_000))
    with pytest.raises(InputError, match=r"u holds 300 million numbers \(2\.4 GB\), but at most 50 million"):
        array_columns(path, ["u"])


def test_a_matlab_bomb_is_refused_too(tmp_path, monkeypatch):
    savemat(tmp_path / "a.mat", {"u": np.zeros((200_000, 2))}, do_compression=True)
    monkeypatch.setattr("hammerstein.records.checks.MOST_NUMBERS", 100_000)
    with pytest.raises(InputError, match="decompresses to"):
        array_columns(tmp_path / "a.mat", ["u:1"])


def test_an_hdf5_bomb_is_refused_by_its_shape(tmp_path):
    import h5py

    with h5py.File(tmp_path / "a.mat", "w") as file:
        file.create_dataset("u", shape=(1, 10**10), dtype="f8", chunks=(1, 1000))
    with pytest.raises(InputError, match="holds 10,000 million numbers"):
        array_columns(tmp_path / "a.mat", ["u"])


def test_a_damaged_header_of_numpy_is_told_in_words(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((10, 2)))
    data = (tmp_path / "a.npy").read_bytes().replace(b"(10, 2)", b"f(10,2)")
    (tmp_path / "a.npy").write_bytes(data)
    with pytest.raises(InputError, match="its header is damaged"):
        array_columns(tmp_path / "a.npy", ["1"])
