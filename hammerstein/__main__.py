"""Where the command line begins: ``hammerstein``, and ``python -m hammerstein``.

What must hold from the first line on is here, and nothing else is imported before it does.
"""

import os
import sys

from hammerstein.runtime.signals import end_when_asked


def main() -> None:
    """Run the command line."""
    end_when_asked()
    _fill_the_standard_streams()
    from hammerstein.commands.cli import main as command_line

    command_line()


def _fill_the_standard_streams() -> None:
    """Open what the caller has closed: the next file would take its place, and get what is said there."""
    while (handle := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(handle)
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115  # until the end


if __name__ == "__main__":
    main()
