"""What commands refuse before they begin, in the words of their options."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

if TYPE_CHECKING:
    from hammerstein.runtime.storage.manifest import Owner

_ALONE = ("start", "range", "axes")
"""Options whose own values make a message of their own."""
_OPTIONS = {
    "sample_time_s": "sample-time",
    "range_v": "range",
    "start_v": "start",
    "sensor_bandwidth_hz": "sensor-bandwidth",
    "sensor_delay_s": "sensor-delay",
    "thresholds_v": "thresholds",
}


def refuse_output(out: Path, inputs: list[Path], owner: Owner, overwrite: bool) -> None:
    """Refuse an output that cannot be written, is somebody's file, or one of the files that are read."""
    from hammerstein.errors import InputError
    from hammerstein.runtime.storage.staging import prepare_file

    if any(path.resolve() == out.resolve() for path in inputs):
        raise InputError("--out", f"{out} is one of the input files; choose another name")
    prepare_file("--out", out, owner, overwrite)


def write_output(out: Path, content: str | BinaryIO, owner: Owner, overwrite: bool) -> None:
    """Write one file; say where the one went that a person had changed."""
    from hammerstein.commands.terminal import tell_kept
    from hammerstein.runtime.storage.staging import write_file

    tell_kept(write_file(out, content, owner, overwrite))


@contextmanager
def told_by_options(source: str, own: Collection[str] = ()) -> Iterator[None]:
    """Make the mistakes in arguments of a function name the command's options.

    own : keys that were given as ``--option KEY=VALUE``
    """
    from hammerstein.errors import InputError

    try:
        yield
    except InputError as error:
        if error.source in _ALONE:
            raise InputError(f"--{error.source}", error.mistakes) from None
        if error.source != source:
            raise
        named = [m._replace(where=_option_of(m.where, own)) for m in error.mistakes]
        raise InputError("options", named) from None


def _option_of(where: str, own: Collection[str]) -> str:
    """Option that gave a setting; nothing where the mistake is of them together."""
    name = where.partition("[")[0]
    if name.partition(".")[0] in own:
        return f"--option {where}"
    return f"--{_OPTIONS.get(name, name.replace('_', '-'))}" * bool(name)
