import pytest


@pytest.fixture(autouse=True, scope="session")
def own_cache(tmp_path_factory):
    """Keep results of identifications for this run of the tests only."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HAMMERSTEIN_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield
