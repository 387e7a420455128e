"""Programs to read and to run: ``python -m hammerstein.examples.NAME``."""
