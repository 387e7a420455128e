"""Figures of a report, in the paper's arrangement.

``loops``, ``sweep`` and ``path`` draw plain arrays and know nothing of scenarios; ``choice`` picks what a
report is answered with; ``write`` puts it into files.
"""

from hammerstein.figures.choice import figures_of
from hammerstein.figures.write import write_figures

__all__ = ["figures_of", "write_figures"]
