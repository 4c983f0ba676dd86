"""``python -m grainfall.cli``, where the console script is not on the path."""

from grainfall.cli import main

main()
