"""Measured records: reading, checking, how they were driven, and their loops."""
