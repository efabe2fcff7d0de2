"""The command line in this process, which has loaded already what a command needs."""

from __future__ import annotations

import io
import json
import logging
from contextlib import redirect_stderr, redirect_stdout
from typing import Any

import pytest
import structlog

from mavcal.service.cli import main


def mavcal(*arguments: str) -> tuple[int, dict[str, Any], str]:
    """Exit code, JSON and stderr of a command."""
    handlers = len(logging.getLogger().handlers)
    out, said = io.StringIO(), io.StringIO()
    try:
        with redirect_stdout(out), redirect_stderr(said), pytest.raises(SystemExit) as ended:
            main([*arguments, "--json"])
    finally:
        structlog.reset_defaults()
        for handler in logging.getLogger().handlers[handlers:]:
            logging.getLogger().removeHandler(handler)
    assert "Traceback" not in said.getvalue(), said.getvalue()
    return int(ended.value.code or 0), json.loads(out.getvalue() or "{}"), said.getvalue()
