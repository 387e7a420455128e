"""From measured records to a model: static block, dynamics, verdict."""
