"""``python -m service`` is ``mavcal``."""

from service.cli import main

main()
