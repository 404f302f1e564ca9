"""`python -m hiermap_cli` is the command `hiermap`."""

from hiermap_cli.commands.main import main

main()
