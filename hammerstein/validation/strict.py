"""What a file holds, as a value: frozen, and without any key that it does not know."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Strict(BaseModel):
    """A frozen value that refuses keys that it does not know."""

    model_config = ConfigDict(frozen=True, extra="forbid")
