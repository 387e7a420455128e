"""Figures of a report, in the paper's arrangement.

``loops``, ``sweep`` and ``path`` draw plain arrays and know nothing of scenarios; ``choice`` picks what a
report is answered with; ``write`` puts it into files.
"""

from hammerstein.reporting.figures.choice import figures_of
from hammerstein.reporting.figures.loops import LoopRun, loops_figure
from hammerstein.reporting.figures.write import save_figures

__all__ = ["LoopRun", "figures_of", "loops_figure", "save_figures"]
