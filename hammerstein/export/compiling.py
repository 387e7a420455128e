"""The C compiler of this machine, and exported code as a library of this process."""

from __future__ import annotations

import ctypes
import errno
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hammerstein.arrays import Array
from hammerstein.errors import InputError, InternalError

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
    named = os.environ.get("CC", "").split()
    candidates = [*named[:1], "cc", "gcc", "clang"]
    return next((found for name in candidates if (found := shutil.which(name))), None)


@dataclass(frozen=True)
class CallShape:
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
