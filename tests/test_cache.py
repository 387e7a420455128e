import os
import sys
from importlib import metadata

import pytest

from hammerstein.errors import Notice
from hammerstein.runtime import cache


def kept(function, *arguments):
    """What a caller does: nothing twice."""
    found = cache.known(function, *arguments)
    if found is None:
        found = function(*arguments)
        cache.keep(found, function, *arguments)
    return found


def test_a_result_is_kept_and_counts_for_its_arguments_only(tmp_path, monkeypatch):
    monkeypatch.setenv("HAMMERSTEIN_CACHE", str(tmp_path))
    calls = []

    def work(text, number):
        calls.append((text, number))
        return f"{text} {number}"

    assert [kept(work, "a", 1) for _ in range(3)] == ["a 1"] * 3
    assert kept(work, "a", 2) == "a 2"
    assert calls == [("a", 1), ("a", 2)]


def test_a_command_that_passes_by_what_was_kept_knows_what_it_has_worked_out_itself(tmp_path, monkeypatch):
    monkeypatch.setenv("HAMMERSTEIN_CACHE", str(tmp_path))
    cache.keep("before", str, "a")
    assert cache.known(str, "a", fresh="first") is None
    cache.keep("anew", str, "a", fresh="first")
    assert cache.known(str, "a", fresh="first") == "anew"
    assert cache.known(str, "a", fresh="second") is None
    assert cache.known(str, "a") == "anew"
    for number in range(2 * cache.MOST_MADE):
        cache.keep("x", str, number, fresh="first")
    assert cache.known(str, "a", fresh="first") is None


@pytest.mark.parametrize("what", ["numpy", "numba", "python"])
def test_a_result_of_other_versions_does_not_count(tmp_path, monkeypatch, what):
    monkeypatch.setenv("HAMMERSTEIN_CACHE", str(tmp_path))
    calls = []

    def work(text):
        calls.append(text)
        return text

    kept(work, "a")
    if what == "python":
        monkeypatch.setattr(sys, "version", "3.99.0")
    else:
        real = metadata.version
        monkeypatch.setattr(metadata, "version", lambda name: "99" if name == what else real(name))
    cache._code.cache_clear()
    kept(work, "a")
    assert calls == ["a", "a"]
    monkeypatch.undo()
    cache._code.cache_clear()


def test_it_can_be_switched_off(monkeypatch):
    monkeypatch.setenv("HAMMERSTEIN_CACHE", "")
    calls = []
    for _ in range(2):
        kept(lambda: calls.append(1) or "x")
    assert len(calls) == 2


def test_a_folder_that_cannot_be_written_is_no_mistake(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("HAMMERSTEIN_CACHE", str(tmp_path / "file"))
    assert kept(lambda: "x") == "x"


def spoilt(path, how):
    """Spoil a file as faults do."""
    data = path.read_bytes()
    if how == "truncated":
        path.write_bytes(data[: len(data) // 2])
    elif how == "emptied":
        path.write_bytes(b"")
    elif how == "flipped":
        path.write_bytes(data[:-3] + bytes([data[-3] ^ 1]) + data[-2:])
    elif how == "pipe":
        path.unlink()
        os.mkfifo(path)
    else:
        path.unlink()
        path.mkdir()


FAULTS = ["truncated", "emptied", "flipped", "folder"]
PIPE = pytest.param(
    "pipe", marks=pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes")
)


@pytest.mark.parametrize("how", [*FAULTS, PIPE])
def test_a_spoilt_result_is_told_and_worked_out_again(tmp_path, monkeypatch, how):
    monkeypatch.setenv("HAMMERSTEIN_CACHE", str(tmp_path))
    assert kept(lambda text: text * 3, "abc") == "abcabcabc"
    (path,) = tmp_path.iterdir()
    spoilt(path, how)
    with pytest.warns(Notice, match="again") as told:
        assert kept(lambda text: text * 3, "abc") == "abcabcabc"
    assert str(path) in str(told[0].message)
    if how not in ("folder", "pipe"):
        assert kept(lambda text: "not asked", "abc") == "abcabcabc"


def test_a_user_without_a_home_has_no_kept_results(monkeypatch):
    monkeypatch.delenv("HAMMERSTEIN_CACHE")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(cache.Path, "home", homeless)
    assert cache.folder() is None


def homeless():
    raise RuntimeError("Could not determine home directory.")
