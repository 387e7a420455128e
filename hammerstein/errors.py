"""Errors, one class for each exit code of the command line, and notices, which are none.

Exit codes: 0 fine, 1 a number left its tolerance, 2 a file is wrong,
3 a simulation diverged or is out of reach, 4 identification cannot fit,
70 a fault of ours, or a process that was ended from outside.
"""

import contextlib
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, ClassVar, NamedTuple, TypeVar

from hammerstein.escaping import clean, one_line

S = TypeVar("S")
T = TypeVar("T")


class Notice(UserWarning):
    """Something outside was not as it should be, and was mended or passed by."""


def tell_notices() -> None:
    """Let notices of this process be one line on stderr, each time that there is one.

    What libraries warn of is for programmers: it is shown where ``-W`` or ``PYTHONWARNINGS`` ask for it.
    """
    others = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
        if not issubclass(category, Notice):
            if sys.warnoptions:
                others(message, category, *place, **more)
            return
        with contextlib.suppress(OSError):
            print(clean(str(message)), file=sys.stderr, flush=True)

    warnings.showwarning = show
    warnings.simplefilter("always", Notice)


class HammersteinError(Exception):
    """Any error that a caller can correct. Its text is the whole message for a person."""

    exit_code: ClassVar[int] = 1


class ToleranceError(HammersteinError):
    """A number is outside the tolerance of its baseline."""


class Mistake(NamedTuple):
    """One mistake in a file: its place, and its remedy."""

    where: str
    what: str


class InputError(HammersteinError):
    """A file or a value is wrong.

    Parameters
    ----------
    source : the file, or the name of the value, that is wrong
    mistakes : all mistakes in it, or one sentence
    """

    exit_code = 2

    def __init__(self, source: str, mistakes: str | Sequence[Mistake]):
        self.source = source
        self.mistakes = (Mistake("", mistakes),) if isinstance(mistakes, str) else tuple(mistakes)
        super().__init__(self._message())

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.source, self.mistakes)  # so that it survives a process pool

    def _message(self) -> str:
        source = one_line(self.source)
        if len(self.mistakes) == 1 and not self.mistakes[0].where:
            return f"{source}: {self.mistakes[0].what}"
        width = max(len(m.where) for m in self.mistakes)
        count = f"{len(self.mistakes)} mistake{'s' * (len(self.mistakes) > 1)}"
        lines = [f"  {m.where:<{width}}  {m.what}" for m in self.mistakes]
        return "\n".join([f"{source}: {count}", *lines])


def refuse(source: str, mistakes: Sequence[Mistake]) -> None:
    """Raise InputError for a source with mistakes; one without is fine."""
    if mistakes:
        raise InputError(source, mistakes)


@contextlib.contextmanager
def naming(source: str, instead_of: str | None = None) -> Iterator[None]:
    """Let an InputError name this source, whatever it named, or instead of the given one alone."""
    try:
        yield
    except InputError as error:
        if instead_of not in (None, error.source):
            raise
        raise InputError(source, error.mistakes) from None


def all_of(work: Callable[[S], T], items: Iterable[S], what: str) -> list[T]:
    """Results of some work for each of several files.

    Raises InputError with the mistakes of all: that of one file as it is, several with the file before each.
    """
    done, failures = list[T](), list[InputError]()
    for item in items:
        try:
            done.append(work(item))
        except InputError as error:
            failures.append(error)
    if not failures:
        return done
    if len(failures) == 1:
        raise failures[0]
    mistakes = [
        Mistake(f"{e.source}, {m.where}" if m.where else e.source, m.what)
        for e in failures
        for m in e.mistakes
    ]
    raise InputError(f"{len(failures)} {what}", mistakes)


def labelled(name: str, error: HammersteinError) -> HammersteinError:
    """The same error with a name before its message."""
    if isinstance(error, InputError):
        return InputError(f"{name}: {error.source}", error.mistakes)
    return type(error)(f"{name}: {error}")


class SimulationError(HammersteinError):
    """A simulation diverged, a law cannot converge, or a reference is out of reach."""

    exit_code = 3


class LostProcessError(HammersteinError):
    """The process of a run was ended from outside."""

    exit_code = 70


class IdentificationError(HammersteinError):
    """The data do not determine the requested model."""

    exit_code = 4


class InternalError(HammersteinError):
    """A fault of this program, which no caller can mend."""

    exit_code = 70
