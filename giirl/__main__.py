"""`python -m giirl`: the command without its script."""

from giirl.cli.main import main

main()
