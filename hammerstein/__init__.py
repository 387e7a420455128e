"""Simulate, identify and compensate multi-axis actuators with hysteresis.

Conventions
-----------
* Signals are arrays (axis, sample), time last; operators stand in between: (output, input, operator).
* Units are V, um, s, Hz; names that cross a boundary carry them, such as ``rms_um`` and ``frequency_hz``.
* Blocks start at rest. Where a block has memory, it is an explicit state that goes in and comes out;
  ``respond`` on a whole signal and ``step`` on one sample give identical numbers.
* A voltage is held over each sample; the linear block is discretised exactly for that.

Examples
--------
>>> import hammerstein
>>> actuator = hammerstein.HammersteinModel.load("duo_bimorph_static")
>>> actuator.hysteresis.amplitude(10.0).round(2)
array([[58.4 ,  1.41],
       [ 2.08, 50.57]])
"""

from importlib.metadata import version as _version
from typing import Any

import lazy_loader as _lazy

# The public names stand in ``__init__.pyi`` alone. They are imported when they are used: the command line
# must answer at once.
_find, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    if name == "__version__":  # looking it up reads the metadata of the installation, which takes a while
        return _version("hammerstein-control")
    return _find(name)
