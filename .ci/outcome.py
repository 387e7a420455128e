"""Print the count of a JUnit file as the last line of a run: ``outcome.py FILE``."""

from __future__ import annotations

import sys
from xml.etree import ElementTree

suites = ElementTree.parse(sys.argv[1]).getroot().iter("testsuite")
counts = [
    [int(suite.get(name, "0")) for name in ("tests", "failures", "errors", "skipped")] for suite in suites
]
tests, failures, errors, skipped = (sum(column) for column in zip(*counts, strict=True))
failed = failures + errors
print(f"{tests - failed - skipped} passed, {failed} failed, {skipped} skipped")
