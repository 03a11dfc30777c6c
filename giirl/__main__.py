"""`python -m giirl`: the command without its script."""

from giirl.cli import main

main()
