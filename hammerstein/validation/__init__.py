"""What files hold as frozen values, and from findings of pydantic to mistakes that a person can mend."""

from pydantic import BaseModel, ConfigDict

from hammerstein.validation.findings import mistakes_of as mistakes_of, suggestion as suggestion


class Strict(BaseModel):
    """A frozen value that refuses keys that it does not know."""

    model_config = ConfigDict(frozen=True, extra="forbid")
