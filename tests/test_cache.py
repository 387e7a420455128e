from hammerstein.runtime import cache


def test_a_result_is_kept_and_counts_for_its_arguments_only(tmp_path, monkeypatch):
    monkeypatch.setenv("HAMMERSTEIN_CACHE", str(tmp_path))
    calls = []

    def work(text, number):
        calls.append((text, number))
        return f"{text} {number}"

    assert [cache.kept(work)("a", 1) for _ in range(3)] == ["a 1"] * 3
    assert cache.kept(work)("a", 2) == "a 2"
    assert calls == [("a", 1), ("a", 2)]


def test_it_can_be_switched_off(monkeypatch):
    monkeypatch.setenv("HAMMERSTEIN_CACHE", "")
    calls = []
    for _ in range(2):
        cache.kept(lambda: calls.append(1) or "x")()
    assert len(calls) == 2


def test_a_folder_that_cannot_be_written_is_no_mistake(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("HAMMERSTEIN_CACHE", str(tmp_path / "file"))
    assert cache.kept(lambda: "x")() == "x"
