"""Reports whose figures are drawn in more than one file of tests."""

from __future__ import annotations

from functools import cache
from typing import Any

from hammerstein.experiment.report import Report
from hammerstein.experiment.run import run
from hammerstein.scenario import Scenario

SINE_V = {"kind": "sine", "amplitude_v": 10.0, "frequency_hz": 50.0}
CIRCLE = {"kind": "circle", "radius_um": 40.0, "frequency_hz": 50.0}
PAPER = {"label": "paper", "law": "inverse_multiplicative", "identification": {}}
NONE = {"label": "none", "law": "none", "identification": {}}


def report_of(**content: Any) -> Report:
    return run(Scenario.model_validate({"question": "?", "actuator": "duo_bimorph_static"} | content), "test")


@cache
def loops() -> Report:
    return report_of(drive=SINE_V)


@cache
def circles() -> Report:
    return report_of(reference=CIRCLE, sweep={"radius_um": [15.0, 40.0]}, compensators=[PAPER, NONE])
