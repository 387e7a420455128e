"""Run the command line as ``python -m hammerstein``."""

from hammerstein.cli import main

main()
