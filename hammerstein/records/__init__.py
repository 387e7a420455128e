"""Measured records: reading, checking, preparing, and their loops."""
