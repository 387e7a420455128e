"""The groups of processes that this one belongs to, by which Linux limits what a container may have.

Source: https://docs.kernel.org/admin-guide/cgroup-v2.html, and cgroup-v1 beside it.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

GROUPS = Path("/sys/fs/cgroup")
OWN_GROUP = Path("/proc/self/cgroup")


def groups(controller: str) -> Iterator[tuple[Path, bool]]:
    """Folders of the groups around this process, its own first, and whether they are of version 2.

    controller : what they limit, such as ``memory``; none are given where the system has none
    """
    try:
        lines = OWN_GROUP.read_text().splitlines()
    except OSError:
        return
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if controllers and controller not in controllers.split(","):
            continue
        top = GROUPS / controller if controllers else GROUPS
        folder = top / path.lstrip("/")
        for place in (folder, *folder.parents):
            yield place, not controllers
            if place == top:
                break


def numbers(file: Path) -> list[float]:
    """Numbers in a file of the system; none for one that says "max" or is not there."""
    try:
        return [float(int(word)) for word in file.read_text().split()]
    except (OSError, ValueError):
        return []
