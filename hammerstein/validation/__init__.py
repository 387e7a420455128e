"""From findings of pydantic to mistakes that a person can mend."""

from hammerstein.validation.findings import (
    mistakes_of as mistakes_of,
    suggestion as suggestion,
)
