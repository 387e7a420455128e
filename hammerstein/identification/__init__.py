"""From measured records to a model: reading, loops, static block, dynamics, verdict.

`read_records` gives records, `identify` a model and a `Fit` that says how far it can be trusted. The pieces
can be used alone: `fit_static` (weights by least squares), `closed_form` (the paper's appendix), `fit_axes`
(resonances), `fit_state_space` and `frequency_response` (linear dynamics), `loop_table` (loops).
"""

from hammerstein.identification.closed_form import closed_form
from hammerstein.identification.fit import Fit
from hammerstein.identification.frequency_response import FrequencyResponse, frequency_response
from hammerstein.identification.identify import identify
from hammerstein.identification.loops import Loop, loop_table
from hammerstein.identification.operators import error_curve, input_grids
from hammerstein.identification.partition import thresholds_uniform_in_time, thresholds_uniform_in_voltage
from hammerstein.identification.prediction import Score
from hammerstein.identification.records import Record, read_paired_records, read_records
from hammerstein.identification.second_order import fit_axes, search_axes
from hammerstein.identification.settings import Settings
from hammerstein.identification.state_space import fit_state_space
from hammerstein.identification.static_block import StaticFit, fit_static

__all__ = [
    "Fit",
    "FrequencyResponse",
    "Loop",
    "Record",
    "Score",
    "Settings",
    "StaticFit",
    "closed_form",
    "error_curve",
    "fit_axes",
    "fit_state_space",
    "fit_static",
    "frequency_response",
    "identify",
    "input_grids",
    "loop_table",
    "read_paired_records",
    "read_records",
    "search_axes",
    "thresholds_uniform_in_time",
    "thresholds_uniform_in_voltage",
]
