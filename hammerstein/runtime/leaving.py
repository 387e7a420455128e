"""How the program leaves when it is asked to, before anything else is loaded."""

import os
import signal

INTERRUPTS = tuple(number for number in signal.Signals if number.name in ("SIGINT", "SIGTERM", "SIGHUP"))
INTERRUPTED = 130
LEFT = "interrupted; what was finished is written, and nothing else"


def leave_on_interrupts() -> None:
    """Let Ctrl-C, SIGTERM and a closed terminal end the process at once; what nohup ignores stays so."""
    for number in INTERRUPTS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, leave)


def leave(*_: object) -> None:
    """End at once: nothing is being written, or somebody asks for the second time."""
    try:
        os.write(2, LEFT.encode() + b"\n")
    finally:
        os._exit(INTERRUPTED)
