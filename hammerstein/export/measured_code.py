"""What a machine with a C compiler found out about exported code."""

from __future__ import annotations

from pydantic import Field

from hammerstein.validation import Strict


class MeasuredCode(Strict):
    """Figures that stand in the code, and are kept with it.

    Without a C compiler there are none.
    """

    operations: int | None = Field(default=None, description="most operations of a step that were found")
    samples: int = Field(default=0, description="samples of the search")
    loss_rms: float | None = Field(default=None, description="of single precision, in the unit of the output")
    loss_max: float | None = None
