"""Faults at random times: kills of the run and of its workers, and full disks.

    python tests/faults/campaign.py [KILLS] [FULL_DISKS] [SEED]

After each fault: no file of a person is lost or changed, every report is whole (all files of its manifest,
those of one run), no process is left, and the next run gives the right files.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import psutil

SCENARIO = """
question = "How large is a loop?"
actuator = "duo_bimorph_static"
[drive]
kind = "sine"
amplitude_v = {amplitude}
frequency_hz = 50
[measure]
settle_s = 0
"""
NAMES = ("a", "b", "c")
MINE = {"a/beach.png": b"mine", "b/notes.txt": b"mine", "diary.txt": b"mine"}


class Campaign:
    """A folder of scenarios and one of reports, which every fault leaves whole."""

    def __init__(self, place: Path, seed: int, figures: bool):
        self.options = [] if figures else ["--no-figures"]
        self.place, self.random = place, random.Random(seed)
        self.out = place / "out"
        self.faults = 0

    def begin(self) -> None:
        """Two sets of scenarios whose reports differ, and what right reports are."""
        self.wanted = []
        for number, amplitude in enumerate((10, 8)):
            folder = self.place / f"set{number}"
            folder.mkdir()
            for name in NAMES:
                (folder / f"{name}.toml").write_text(SCENARIO.format(amplitude=amplitude))
            reports, begun = self.place / f"right{number}", time.monotonic()
            self.finish(self.start(number, reports))
            self.lasts_s = time.monotonic() - begun
            self.wanted.append(contents(reports))
        shutil.copytree(self.place / "right0", self.out)
        for name, data in MINE.items():
            (self.out / name).parent.mkdir(parents=True, exist_ok=True)
            (self.out / name).write_bytes(data)
        self.check(whole=0)

    def start(self, number: int, out: Path, size: int | None = None) -> subprocess.Popen[str]:
        """Begin a run of one of the sets."""
        command = [sys.executable, "-m", "hammerstein", "run", str(self.place / f"set{number}")]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        command += ["--out", str(out), "--jobs", "2", *self.options]
        if size is not None:
            command = ["bash", "-c", f'ulimit -f {size}; exec "$@"', "bash", *command]
        return subprocess.Popen(command, **pipes, start_new_session=True)  # type: ignore[call-overload]

    def finish(self, process: subprocess.Popen[str], codes: tuple[int, ...] = (0,)) -> str:
        """Wait for a run; its exit code and its words must be right."""
        error = process.communicate(timeout=300)[1]
        assert process.returncode in codes, (process.returncode, error)
        assert "Traceback" not in error, error
        return error

    def kill(self) -> str:
        """Kill the run, or one of its processes, at a random time; then run again."""
        number = self.faults % 2
        process = self.start(number, self.out)
        top = psutil.Process(process.pid)
        time.sleep(self.random.uniform(0.0, self.lasts_s))
        family: list[psutil.Process] = []
        with contextlib.suppress(psutil.NoSuchProcess):
            family = top.children(recursive=True)
        kind = self.random.choice(("parent", "parent", "worker", "term"))
        victim = top if kind != "worker" or not family else self.random.choice(family)
        with contextlib.suppress(psutil.NoSuchProcess):
            victim.send_signal(signal.SIGTERM if kind == "term" else signal.SIGKILL)
        if victim is top:
            self.finish(process, codes=(0, 130, -signal.SIGKILL, -signal.SIGTERM))
        else:
            self.finish(process, codes=(0, 70))
        left = psutil.wait_procs(family, timeout=10.0)[1]
        assert not left, [p.cmdline() for p in left]
        self.check()
        self.finish(self.start(number, self.out))
        self.check(whole=number)
        return f"{kind}, exit code {process.returncode}"

    def fill(self) -> str:
        """Run on a disk that becomes full; then run again with room."""
        number, size = self.faults % 2, self.random.choice((1, 2, 4, 8, 16, 32, 64))
        with small_disk(self.place) as disk:
            if disk is not None:
                shutil.copytree(self.out, disk / "out", dirs_exist_ok=True)
                fill(disk, self.random.randrange(0, 150_000))
                error = self.finish(self.start(number, disk / "out"), codes=(0, 2))
                self.check(out=disk / "out")
                (disk / "filler").unlink()
                self.finish(self.start(number, disk / "out"))
                self.check(whole=number, out=disk / "out")
                return f"disk full: {error.strip().splitlines()[-1] if error else 'there was room'}"
        error = self.finish(self.start(number, self.out, size), codes=(0, 2))
        self.check()
        self.finish(self.start(number, self.out))
        self.check(whole=number)
        return f"files of {size} kB at most: {error.strip().splitlines()[-1] if error else 'there was room'}"

    def check(self, whole: int | None = None, out: Path | None = None) -> None:
        """Nothing of a person is lost; each report is that of one set, and of the given one after a run."""
        out = self.out if out is None else out
        found = contents(out)
        assert {name: found.get(name) for name in MINE} == MINE
        for name in NAMES:
            report = {k: v for k, v in found.items() if k.startswith(f"{name}/") and k not in MINE}
            hidden = {k: v for k, v in report.items() if "/.hammerstein-new/" in k}
            if whole is not None:
                assert not hidden, sorted(hidden)
            if not any("journal" in k for k in hidden):  # such an exchange is finished by the next run
                sets = [{k: v for k, v in w.items() if k.startswith(f"{name}/")} for w in self.wanted]
                own = {k: v for k, v in report.items() if k not in hidden}
                assert own in (sets if whole is None else [sets[whole]]), sorted(own)
                assert_listed(own, name)


def assert_listed(report: dict[str, bytes], name: str) -> None:
    """Every file is in the manifest, with its digest."""
    listed = json.loads(report[f"{name}/.hammerstein.json"])["files"]
    digests = {f"{name}/{k}": v["sha256"] for k, v in listed.items()}
    for key, digest in digests.items():
        assert hashlib.sha256(report[key].replace(b"\r\n", b"\n")).hexdigest() == digest


def contents(folder: Path) -> dict[str, bytes]:
    """Bytes of every file below a folder."""
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@contextlib.contextmanager
def small_disk(place: Path) -> Iterator[Path | None]:
    """Mount a disk of 2 MB where that is permitted; None where it is not."""
    disk = place / "disk"
    disk.mkdir(exist_ok=True)
    mount = ["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(disk)]
    try:
        permitted = hasattr(os, "geteuid") and os.geteuid() == 0
        permitted = permitted and subprocess.run(mount, capture_output=True, check=False).returncode == 0
    except OSError:
        permitted = False
    try:
        yield disk if permitted else None
    finally:
        if permitted:
            subprocess.run(["umount", str(disk)], check=True)


def fill(disk: Path, room: int) -> None:
    """Leave so many bytes on a disk."""
    free = shutil.disk_usage(disk).free
    (disk / "filler").write_bytes(b"\0" * max(0, free - room))


def run(kills: int, disks: int, seed: int = 1, figures: bool = True) -> None:
    """Do so many faults of each kind."""
    with tempfile.TemporaryDirectory() as place:
        campaign = Campaign(Path(place), seed, figures)
        campaign.begin()
        for fault in [campaign.kill] * kills + [campaign.fill] * disks:
            campaign.faults += 1
            print(f"{campaign.faults}: {fault()}", flush=True)
    print(f"{kills} kills, {disks} full disks: no file lost, no process left, the next run right")


if __name__ == "__main__":
    run(*(int(word) for word in (*sys.argv[1:], *("50", "20", "1")[len(sys.argv) - 1 :])))
