"""Print the count of JUnit files together as the last line of a run: ``outcome.py FILE...``."""

from __future__ import annotations

import sys
from xml.etree import ElementTree

counts = [
    [int(suite.get(name, "0")) for name in ("tests", "failures", "errors", "skipped")]
    for file in sys.argv[1:]
    for suite in ElementTree.parse(file).getroot().iter("testsuite")
]
tests, failures, errors, skipped = (sum(column) for column in zip(*counts, strict=True))
failed = failures + errors
print(f"{tests - failed - skipped} passed, {failed} failed, {skipped} skipped")
