"""The C compiler of this machine, exported code as a library of this process, and a signal to try it with."""

from __future__ import annotations

import ctypes
import errno
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hammerstein.arrays import Array
from hammerstein.blocks import Law
from hammerstein.errors import InputError, InternalError
from hammerstein.export.request import ForwardModel
from hammerstein.model import HammersteinModel

FLAGS = ("-std=c99", "-O2", "-ffp-contract=off")
RUN = """
const int64_t state_bytes = sizeof({name});
void run({name} *law, const {real} *in, {real} *out, int32_t samples, int64_t *most)
{{
  for (int32_t t = 0; t < samples; t++) {{
    {before}
    (void){name}_step(law, in + t * {entering}, out + t * {leaving});
    {after}
  }}
}}
"""


def compiler() -> str | None:
    """Command of the C compiler: ``CC``, cc, gcc or clang; None if there is none."""
    candidates = [*os.environ.get("CC", "").split()[:1], "cc", "gcc", "clang"]
    return next((found for name in candidates if (found := shutil.which(name))), None)


class CallShape(NamedTuple):
    """How a law is called: its name, its kind of numbers, how many go in and come out."""

    name: str
    real: str
    entering: int
    leaving: int


class Library:
    """Exported code, compiled and loaded, until the block is left.

    Parameters
    ----------
    shape : how the law is called
    code : its C in one file
    counting : whether the code counts its operations
    command, flags : compiler and its options
    """

    def __init__(
        self,
        shape: CallShape,
        code: str,
        counting: bool = False,
        command: str | None = None,
        flags: Sequence[str] = FLAGS,
    ):
        self.shape = shape
        self._folder = tempfile.TemporaryDirectory(prefix="hammerstein-")
        before, after = ("operations = 0;", "*most = operations > *most ? operations : *most;")
        if not counting:
            before, after = "", "(void)most;"
        names = {"name": shape.name, "real": shape.real, "before": before, "after": after}
        driver = RUN.format(entering=shape.entering, leaving=shape.leaving, **names)
        source = Path(self._folder.name) / "law.c"
        source.write_text(code + driver, encoding="utf-8")
        place = source.with_suffix(".so")
        build([str(source), "-shared", "-fPIC", "-o", str(place)], flags, command)
        self._library: Any = ctypes.CDLL(str(place))

    def __enter__(self) -> Library:
        return self

    def __exit__(self, *_: object) -> None:
        self._folder.cleanup()

    @property
    def state_bytes(self) -> int:
        """Bytes of its structure, as the compiler laid it out."""
        return ctypes.c_int64.in_dll(self._library, "state_bytes").value

    def rest(self) -> Any:
        """Memory of a law at its start."""
        law = ctypes.create_string_buffer(self.state_bytes)
        self.function("init")(law)
        return law

    def function(self, name: str) -> Any:
        """One of its functions, such as ``step``."""
        return getattr(self._library, f"{self.shape.name}_{name}")

    def respond(self, entering: Array, law: Any = None) -> tuple[Array, int]:
        """Output (axis, sample), and the most operations of a step if they are counted."""
        law = law or self.rest()
        kind = np.float64 if self.shape.real == "double" else np.float32
        into = np.ascontiguousarray(entering.T, dtype=kind)
        out = np.empty((into.shape[0], self.shape.leaving), dtype=kind)
        most = ctypes.c_int64(0)
        samples = ctypes.c_int32(into.shape[0])
        pointers = (ctypes.c_void_p(a.ctypes.data) for a in (into, out))
        self._library.run(law, *pointers, samples, ctypes.byref(most))
        return np.asarray(out.T, dtype=np.float64), most.value


def build(arguments: Sequence[str], flags: Sequence[str] = FLAGS, command: str | None = None) -> None:
    """Call the C compiler, or another one by its command.

    Raises
    ------
    InputError : there is none, or its temporary folder is full
    InternalError : it refuses our code
    """
    command = command or compiler()
    if command is None:
        raise InputError(
            "C compiler", "a C compiler is needed here (cc, gcc or clang); install one, or name it in CC"
        )
    folder = tempfile.gettempdir()  # it passes by a TMPDIR that is full or not there; the compiler does not
    line, around = [command, *flags, *arguments], {**os.environ, "LC_ALL": "C", "TMPDIR": folder}
    done = subprocess.run(line, capture_output=True, text=True, check=False, env=around)
    if done.returncode != 0:
        if os.strerror(errno.ENOSPC) in done.stderr:
            raise InputError(folder, f"is full: {command} cannot write there; free some space, or set TMPDIR")
        raise InternalError(f"{command} refuses the exported code: {done.stderr.strip()[:2000]}")


SAMPLES = 2000  # of the table that is shipped
DIGITS = 6  # after the point: what a sine is in the last bits differs between machines
WAVES = 6  # of the signal; the first one is smooth and within the reach
BEYOND = 1.6  # times the reach, where it saturates


def entering(block: Law[Any] | ForwardModel, model: HammersteinModel, samples: int, seed: int = 1) -> Array:
    """Signal (axis, sample) for a law [um], or for the model itself [V]."""
    limits = block.range
    if isinstance(block, ForwardModel):
        middle, half = 0.5 * (limits.low_v + limits.high_v), 0.5 * limits.span_v
    else:
        middle, half = _reach(block, model)
    whole = np.concatenate(list(_waves(len(middle), samples, seed)), axis=1)[:, :samples]
    signal = middle[:, None] + half[:, None] * whole
    if isinstance(block, ForwardModel):
        signal = np.clip(signal, limits.low_v[:, None], limits.high_v[:, None])
    return np.asarray(np.round(signal, DIGITS) + 0.0)  # no negative zero


def adverse(block: Law[Any] | ForwardModel, model: HammersteinModel, samples: int) -> Array:
    """Many such signals one after the other, each with other walks, noise and plateaus (axis, sample)."""
    times = -(-samples // SAMPLES)
    parts = [entering(block, model, SAMPLES, seed) for seed in range(2, 2 + times)]
    return np.concatenate(parts, axis=1)[:, :samples]


def _reach(law: Law[Any], model: HammersteinModel) -> tuple[Array, Array]:
    """Middle and half width (p,) of where the actuator can go, counted from its start [um]."""
    limits = law.range
    ends = np.stack([limits.start_v, limits.low_v, limits.high_v], axis=1)
    drives = np.where(np.eye(len(ends), dtype=bool)[:, :, None], ends, limits.start_v[:, None])
    rows = np.array([model.static_response(drive)[0] for drive in drives])
    moved = rows[:, :, 1:] - rows[:, :, :1]
    low, high = moved.min(axis=2).min(axis=0), moved.max(axis=2).max(axis=0)
    return 0.5 * (low + high), 0.5 * (high - low)


def _waves(axes: int, samples: int, seed: int) -> Iterator[Array]:
    """Parts within -1 to 1, but for the saturated one."""
    words, n = np.random.PCG64(seed), -(-samples // WAVES)
    turn = 2.0 * np.pi * np.arange(n) / n
    rates = 3.0 + 2.0 * np.arange(axes)[:, None]
    yield 0.8 * np.sin(rates * turn) * np.minimum(1.0, 2.0 * turn / np.pi)
    yield 0.9 * np.sin(np.cumsum(_uniform(words, axes, n) / 8.0, axis=1))
    yield 0.7 * _uniform(words, axes, n)
    yield np.repeat(0.8 * _uniform(words, axes, -(-n // 25)), 25, axis=1)[:, :n]
    yield BEYOND * np.sin((rates - 1.5) * turn)
    yield 0.9 * np.cos(7.0 * turn) * (1.0 - turn / (2.0 * np.pi)) * np.ones((axes, 1))


def _uniform(words: np.random.PCG64, axes: int, samples: int) -> Array:
    """Numbers (axis, sample) from -1 to 1 that no version of NumPy changes: raw words of a generator."""
    raw = np.asarray(words.random_raw(axes * samples), dtype=np.uint64) >> np.uint64(11)
    return (2.0 * raw.astype(np.float64) * 2.0**-53 - 1.0).reshape(axes, samples)


STARTS, ROUNDS, LENGTH = 8, 80, 60  # of a random search: begins, changes of each, length of a drive
LEVELS = 40  # from the middle to the reach, and a quarter of that beyond it


def worst_case_step(operations: Callable[[Array], int], reach: Array) -> tuple[int, int]:
    """Most operations of a step that a climbing search finds, and the samples it tried.

    The search changes sequences of levels in a few samples at a time, and keeps a change if the most
    expensive step is no cheaper. Jumps after many turns are expensive. Every other search only jumps to the
    ends of the reach, because the longest jumps cost most with parallel blocks.

    Parameters
    ----------
    operations : operations of the most expensive step of a signal (axis, sample) from the start
    reach : (axis,) largest value of each axis
    """
    words, axes, worst = np.random.PCG64(11), len(reach), 0

    def levels(samples: int) -> Array:
        return np.asarray(np.round(1.25 * LEVELS * _uniform(words, axes, samples)) / LEVELS)

    for start in range(STARTS):
        best, most = levels(LENGTH), 0
        for _ in range(ROUNDS):
            trial = best.copy()
            where = (0.5 * LENGTH * (_uniform(words, 1, 3)[0] + 1.0)).astype(np.int64)
            jumps = levels(len(where))
            trial[:, where] = 1.25 * np.sign(jumps) if start % 2 else jumps
            found = operations(reach[:, None] * trial)
            if found >= most:
                best, most = trial, found
        worst = max(worst, most)
    return worst, STARTS * ROUNDS * LENGTH
