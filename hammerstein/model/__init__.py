"""Actuator models: model files and simulation."""

from hammerstein.model.model import (
    HammersteinModel as HammersteinModel,
    ModelFile as ModelFile,
    model_text as model_text,
    packaged_actuators as packaged_actuators,
    place_of as place_of,
)
