"""The user's cache folder."""

from hammerstein.runtime import cache


def test_a_user_without_a_home_has_no_kept_results(monkeypatch):
    monkeypatch.delenv("HAMMERSTEIN_CACHE")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(cache.Path, "home", homeless)
    assert cache.cache_folder() is None


def homeless():
    raise RuntimeError("Could not determine home directory.")
