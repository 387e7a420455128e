"""Validation of files: pydantic's findings as mistakes with place and remedy."""

from pydantic import BaseModel, ConfigDict

from hammerstein.validation.findings import (
    mistakes_in as mistakes_in,
    mistakes_of as mistakes_of,
    suggestion as suggestion,
)


class Strict(BaseModel):
    """A frozen value that refuses keys that it does not know."""

    model_config = ConfigDict(frozen=True, extra="forbid")
