"""Run the command line as ``python -m hammerstein``."""

from hammerstein.commands.cli import main

main()
