"""What files hold as frozen values, and from findings of pydantic to mistakes that a person can mend."""

from hammerstein.validation.findings import mistakes_of as mistakes_of, suggestion as suggestion
from hammerstein.validation.strict import Strict as Strict
