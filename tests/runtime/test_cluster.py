"""Work sent to a Dask scheduler: the same bits, whoever does it, and whoever dies."""

import asyncio
import importlib.util
import json
import os
import re
import socket
import subprocess
import sys
import threading
import time
import warnings
from pathlib import Path

import pytest
from threadpoolctl import threadpool_info

import hammerstein
from hammerstein.commands.cli import main
from hammerstein.errors import InputError, LostProcessError, Notice
from hammerstein.runtime import cluster
from hammerstein.runtime.store import Store, computes_with, processor

pytestmark = [
    pytest.mark.full,
    pytest.mark.skipif(
        importlib.util.find_spec("distributed") is None, reason="needs hammerstein-control[cluster]"
    ),
]

SCENARIO = """
question = "How large is the error of drawn actuators?"
seed = 3
[reference]
kind = "circle"
radius_um = 10
frequency_hz = 50
[sweep]
frequency_hz = [20, 35, 50]
[[compensators]]
label = "exact"
law = "exact_inverse"
identification = { method = "closed_form", amplitude_v = 10, frequency_hz = 50, operators = 5 }
[uncertainty]
draws = 60
weights = 0.02
resonance = 0.01
"""
STUDY = """
[study]
how = "product"
[study.values]
"reference.radius_um" = [2, 5, 10, 11, 12]
"""
SLOW = """
question = "Does it end?"
actuator = "duo_bimorph_static"
[measure]
measured_cycles = 200
[drive]
kind = "sine"
amplitude_v = 10
frequency_hz = 50
[sweep]
frequency_hz = [50, 51, 52, 53, 54, 55, 56, 57, 58, 59, 60, 61]
"""


class Dask:
    """A scheduler and its workers, each a process of its own."""

    def __init__(self, folder: Path, workers: int = 2) -> None:
        self.folder, file = folder, folder / "scheduler.json"
        place = ("--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(file))
        self.scheduler = self._start("scheduler", *place)
        until = time.monotonic() + 60.0
        while not file.exists() and time.monotonic() < until:
            time.sleep(0.05)
        time.sleep(0.1)
        self.address = json.loads(file.read_text())["address"]
        (folder / "worker.log").touch()
        self.workers = [self.worker() for _ in range(workers)]
        self.wait_for(workers)

    def wait_for(self, workers: int) -> None:
        """Wait until so many have registered since the beginning."""
        until = time.monotonic() + 60.0
        log = self.folder / "worker.log"
        while log.read_text().count("Registered to") < workers and time.monotonic() < until:
            time.sleep(0.05)

    def worker(self, **more: str) -> subprocess.Popen:
        return self._start(
            *("worker", self.address, "--host", "127.0.0.1", "--nthreads", "1"),
            *("--no-nanny", "--no-dashboard"),
            **more,
        )

    def _start(self, *arguments: str, **more: str) -> subprocess.Popen:
        log = (self.folder / f"{arguments[0]}.log").open("a")
        env = os.environ | {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1"} | more
        command = [sys.executable, "-m", "dask", *arguments]
        with log:
            return subprocess.Popen(command, stdout=log, stderr=log, cwd=self.folder, env=env)

    def end(self) -> None:
        for process in (*self.workers, self.scheduler):
            if process.poll() is None:
                process.kill()
            process.wait()


@pytest.fixture(scope="module")
def dask(tmp_path_factory):
    found = Dask(tmp_path_factory.mktemp("dask"))
    yield found
    found.end()


@pytest.fixture
def own_dask(tmp_path, request):
    """A cluster of a test that ends its scheduler; with two workers, if the test names no other number."""
    (tmp_path / "dask").mkdir()
    found = Dask(tmp_path / "dask", getattr(request, "param", 2))
    yield found
    found.end()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HAMMERSTEIN_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("HAMMERSTEIN_CACHE_MB", "500")
    (tmp_path / "drawn.toml").write_text(SCENARIO)
    (tmp_path / "study.toml").write_text(SCENARIO.partition("[uncertainty]")[0] + STUDY)
    (tmp_path / "slow.toml").write_text(SLOW)
    return tmp_path


def call(*arguments):
    with pytest.raises(SystemExit) as caught:
        main([str(argument) for argument in arguments])
    return int(caught.value.code or 0)


def test_a_run_is_the_same_to_the_last_byte(folder, dask, capsys):
    options = ("--no-figures", "--fresh", "--traces", "csv")
    assert call("run", "drawn.toml", "--out", "here", "--jobs", 1, *options) == 0
    capsys.readouterr()
    assert call("run", "drawn.toml", "--out", "there", "--cluster", dask.address, *options) == 0
    assert f"using 2 workers of {dask.address}" in capsys.readouterr().err
    names = sorted(path.relative_to("here") for path in Path("here").rglob("*") if path.is_file())
    assert len(names) >= 8
    assert {n: (folder / "there" / n).read_bytes() for n in names if not n.name.startswith(".")} == {
        n: (folder / "here" / n).read_bytes() for n in names if not n.name.startswith(".")
    }


def test_cases_draws_and_identifications_are_what_is_sent(folder, dask):
    sent = []
    with cluster.joined(dask.address) as crew:
        submit = crew.submit
        crew.submit = lambda fn, *args: sent.append(fn.func.__name__) or submit(fn, *args)
        hammerstein.run(folder / "drawn.toml", jobs=crew)
    assert sent == ["_identified", *["rows_of"] * 3, *["_over"] * 3]


def test_a_sweep_and_a_check_are_the_same(folder, dask, capsys):
    assert call("sweep", "study.toml", "--out", "here.csv", "--fresh") == 0
    assert call("sweep", "study.toml", "--out", "there.csv", "--fresh", "--cluster", dask.address) == 0
    assert (folder / "here.csv").read_bytes() == (folder / "there.csv").read_bytes()
    assert len((folder / "here.csv").read_text().splitlines()) == 1 + 5 * 3 * 2
    (folder / "scenarios").mkdir()
    (folder / "drawn.toml").rename("scenarios/drawn.toml")
    assert call("check", "scenarios", "--baseline", "b", "--update-baseline") == 0
    assert call("check", "scenarios", "--baseline", "b", "--cluster", dask.address) == 0


def test_a_killed_worker_is_survived(folder, dask, capsys):
    def kill():
        until = time.monotonic() + 60.0
        while not list((folder / "cache/kept").rglob("??/*")) and time.monotonic() < until:
            time.sleep(0.02)
        dask.workers[0].kill()

    killer = threading.Thread(target=kill)
    killer.start()
    assert call("run", "slow.toml", "--no-figures", "--cluster", dask.address) == 0
    killer.join()
    assert dask.workers[0].wait() == -9
    dask.workers[0] = dask.worker()
    dask.wait_for(3)
    found = (folder / "reports/slow/report.json").read_bytes()
    assert call("run", "slow.toml", "--no-figures", "--fresh", "--jobs", 1, "--out", "here") == 0
    assert (folder / "here/slow/report.json").read_bytes() == found


@pytest.mark.parametrize("own_dask", [1], indirect=True)
def test_a_lost_scheduler_is_told_and_what_was_finished_is_kept(folder, own_dask, capsys):
    def kill():
        until = time.monotonic() + 60.0
        while len(list((folder / "cache/kept").rglob("??/*"))) < 2 and time.monotonic() < until:
            time.sleep(0.02)
        own_dask.scheduler.kill()

    killer = threading.Thread(target=kill)
    killer.start()
    start = time.monotonic()
    code = call("run", "slow.toml", "--no-figures", "--cluster", own_dask.address)
    killer.join()
    assert time.monotonic() - start < 60.0
    error = capsys.readouterr().err
    assert (code, error.count("is lost")) == (70, 1), error
    assert f"slow: the scheduler at {own_dask.address} is lost; finished work is kept" in error
    assert "Traceback" not in error
    kept = list((folder / "cache/kept").rglob("??/*"))
    assert 2 <= len(kept) < 12
    times = {path: path.stat().st_ino for path in kept}
    assert call("run", "slow.toml", "--no-figures", "--jobs", 1) == 0
    assert {path: path.stat().st_ino for path in kept} == times  # not written again


class Forgotten:
    """A future of Dask that nobody tells anything."""

    def __await__(self):
        return asyncio.sleep(3600.0).__await__()


@pytest.mark.long
def test_a_task_that_dask_forgets_when_the_scheduler_is_lost_is_told(own_dask, monkeypatch):
    with cluster.joined(own_dask.address) as crew:
        # as while the connection breaks
        monkeypatch.setattr(crew._client, "submit", lambda *_, **__: Forgotten())
        waiting = crew.submit(os.getpid)
        own_dask.scheduler.kill()
        error = waiting.exception(60)
        assert isinstance(error, LostProcessError)
        with pytest.raises(LostProcessError, match="is lost"):
            crew.submit(os.getpid)


@pytest.mark.long
def test_a_task_that_kills_its_workers_is_told(own_dask):
    with cluster.joined(own_dask.address) as crew:
        died = crew.submit(os._exit, 9).exception(60)
    assert isinstance(died, LostProcessError)
    assert "2 workers died with the same task" in str(died)


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("nonsense", "missing port"),
        ("ftp://127.0.0.1:1", "unknown address scheme 'ftp'"),
        ("tcp://127.0.0.1:{closed}", "no Dask scheduler answers"),
        ("tcp://nowhere.invalid:8786", "no Dask scheduler answers"),
        ("tcp://127.0.0.1:{mute}", "no Dask scheduler answers"),
        ("{worker}", "no Dask scheduler answers"),
    ],
)
def test_a_wrong_address_is_one_message_within_seconds(folder, dask, capfd, address, words):
    with socket.socket() as closed, socket.socket() as mute:
        closed.bind(("127.0.0.1", 0))
        mute.bind(("127.0.0.1", 0))
        mute.listen()
        ports = {"closed": closed.getsockname()[1], "mute": mute.getsockname()[1]}
        worker = re.findall(r"Start worker at: *(tcp://\S+)", (dask.folder / "worker.log").read_text())[-1]
        start = time.monotonic()
        assert call("run", "drawn.toml", "--cluster", address.format(worker=worker, **ports)) == 2
    assert time.monotonic() - start < 20.0
    error = capfd.readouterr().err
    assert error.startswith("--cluster: ")
    assert re.search(words, error), error
    assert error.count("\n") == 1
    assert not (folder / "reports/drawn/report.json").exists()


def test_without_dask_one_message_says_what_to_install(folder, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert call("run", "drawn.toml", "--cluster", "tcp://127.0.0.1:1") == 2
    assert "pip install 'hammerstein-control[cluster]'" in capsys.readouterr().err


@pytest.mark.parametrize("name", [*computes_with()])
def test_other_versions_are_named_before_work_is_sent(dask, monkeypatch, name):
    ours = computes_with()
    monkeypatch.setattr(cluster, "computes_with", lambda: ours | {name: "0.0.7"})
    with pytest.raises(InputError, match=f": {name} 0.0.7 here, {re.escape(ours[name])} there. Install"):
        cluster.joined(dask.address).__enter__()


def test_a_worker_that_joins_later_is_looked_at_as_well(dask):
    with cluster.joined(dask.address) as crew:
        crew._expected = (*crew._expected, ("numpy", "0.0.7"))
        with pytest.raises(InputError, match=r"would differ from those of this machine .*: numpy 0.0.7 here"):
            crew.submit(int, "3").result(30)


def test_results_of_another_processor_are_kept_apart(tmp_path, dask, monkeypatch):
    monkeypatch.setattr(cluster, "processor", lambda: "another")
    with pytest.warns(Notice, match="another type of processor"), cluster.joined(dask.address) as crew:
        assert crew.elsewhere
    own = Store(tmp_path)
    assert own.computed("") is own
    assert own._path("abcd") != own.computed(crew.elsewhere)._path("abcd")
    assert own.computed(crew.elsewhere)._path("abcd") != own.computed("third")._path("abcd")
    assert processor()


@pytest.mark.parametrize("own_dask", [0], indirect=True)
def test_linear_algebra_runs_on_one_thread(own_dask):
    own_dask.workers.append(own_dask.worker(OPENBLAS_NUM_THREADS="2"))
    own_dask.wait_for(1)
    with cluster.joined(own_dask.address) as crew:
        libraries = [one for one in crew.submit(threadpool_info).result(60) if one["user_api"] == "blas"]
    assert [one["num_threads"] for one in libraries] == [1] * len(libraries) != []


@pytest.mark.long
def test_it_waits_for_a_worker(own_dask):
    for worker in own_dask.workers:
        worker.kill()
        worker.wait()
    time.sleep(1.0)
    threading.Timer(1.0, lambda: own_dask.workers.append(own_dask.worker())).start()
    with warnings.catch_warnings(record=True) as told, cluster.joined(own_dask.address) as crew:
        warnings.simplefilter("always")
        assert crew.workers == 1
        assert crew.submit(int, "3").result(60) == 3
        own_dask.workers[-1].kill()
        time.sleep(3 * cluster.LOOK_S)
    words = [str(one.message).partition(": ")[2] for one in told if one.category is Notice]
    assert words == ["no worker is connected yet; waiting for one", "no worker is left; waiting for others"]
