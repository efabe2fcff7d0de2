"""``python -m mavcal`` is ``mavcal``."""

from mavcal.service.cli import main

main()
