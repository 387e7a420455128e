"""Identification of a model from measured records: static block, dynamics, verdict."""
