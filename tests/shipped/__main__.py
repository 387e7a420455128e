"""Make the files that are shipped with the package: ``python -m tests.shipped [actuators] [starter]``."""

from __future__ import annotations

import sys
from pathlib import Path

import hammerstein

from . import paper_actuators, stacks, starter

PACKAGE = Path(hammerstein.__file__).parent


def main(asked: list[str]) -> None:
    """Write them anew where they lie, all or those that are named."""
    if "actuators" in asked or not asked:
        paper_actuators.build(PACKAGE / "actuators")
        stacks.build(PACKAGE / "actuators")
    if "starter" in asked or not asked:
        starter.build(PACKAGE / "starter")


if __name__ == "__main__":
    main(sys.argv[1:])
