"""Processors, memory limits and cache folder of a process, in containers and without a home."""

import os
import platform
import subprocess
import sys

import pytest

from hammerstein.runtime import resources
from hammerstein.runtime.resources import processors

SAYS = [sys.executable, "-c", "from hammerstein.runtime.resources import processors; print(processors())"]


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system lets no process be bound")
def test_a_bound_process_has_the_processors_that_it_is_bound_to():
    one = min(os.sched_getaffinity(0))
    done = subprocess.run(
        SAYS, capture_output=True, text=True, check=True, preexec_fn=lambda: os.sched_setaffinity(0, {one})
    )
    assert done.stdout == "1\n"


QUOTA, PERIOD = "cpu/pod/cpu.cfs_quota_us", "cpu/pod/cpu.cfs_period_us"


@pytest.mark.parametrize(
    ("group", "files", "wanted"),
    [
        ("0::/pod/inner", {"pod/cpu.max": "200000 100000", "pod/inner/cpu.max": "max 100000"}, 2),
        ("0::/pod/inner", {"pod/cpu.max": "800000 100000", "pod/inner/cpu.max": "150000 100000"}, 2),
        ("0::/pod", {"pod/cpu.max": "20000 100000"}, 1),
        ("0::/pod", {"pod/cpu.max": "max 100000"}, 64),
        ("0::/pod", {}, 64),
        ("4:cpu,cpuacct:/pod", {QUOTA: "300000", PERIOD: "100000"}, 3),
        ("4:cpu,cpuacct:/pod", {QUOTA: "-1", PERIOD: "100000"}, 64),
        ("4:memory:/pod", {QUOTA: "1", PERIOD: "100000"}, 64),
    ],
)
def test_the_tightest_limit_of_a_container_counts_and_parts_are_rounded_up(
    monkeypatch, tmp_path, group, files, wanted
):
    (tmp_path / "own").write_text(group + "\n")
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text + "\n")
    monkeypatch.setattr(resources, "GROUPS", tmp_path)
    monkeypatch.setattr(resources, "OWN_GROUP", tmp_path / "own")
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: range(64), raising=False)
    assert processors() == wanted


def test_a_system_that_tells_no_more_tells_how_many_there_are(monkeypatch, tmp_path):
    monkeypatch.setattr(resources, "OWN_GROUP", tmp_path / "none")
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    for told, wanted in ((6, 6), (None, 1)):
        monkeypatch.setattr(os, "cpu_count", lambda told=told: told)
        assert processors() == wanted


def test_a_user_without_a_home_has_no_kept_results(monkeypatch):
    monkeypatch.delenv("HAMMERSTEIN_CACHE")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(resources.Path, "home", homeless)
    assert resources.cache_folder() is None


def homeless():
    raise RuntimeError("Could not determine home directory.")


def test_freed_memory_is_kept_for_the_next_array():
    """Pages of 50 times ten arrays of 4 MB, freed before the next ones: 500,000 if none is kept."""
    if platform.libc_ver()[0] != "glibc":
        pytest.skip("the C library is not glibc")
    program = """
import resource, numpy as np
from hammerstein.runtime.resources import keep_freed_memory
keep_freed_memory()
[np.ones(500_000) for _ in range(10)]
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(50):
    [np.ones(500_000) for _ in range(10)]
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""
    new = int(subprocess.run([sys.executable, "-c", program], capture_output=True, check=True).stdout)
    assert new < 20_000
