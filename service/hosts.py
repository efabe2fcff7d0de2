"""How host systems find the service and show its panel: BlueOS, and Cockpit inside it.

BlueOS reads the keys of `/register_service`, Cockpit those of its manifest: in camel case today, in snake case in older
versions.
"""

from __future__ import annotations

import re
from typing import Any

from mavcal import calib

NAME = "mavcal"
DESCRIPTION = "Calibrates the sensors of MAVLink vehicles from the ground, and proves that the result took effect."
EXTRAS = "/cockpit_extras.json"
COMPASS_WIDGET = "?cockpit_mode=1#/widget"


def registration() -> dict[str, Any]:
    """Description of the service for BlueOS, which asks every open port for it."""
    return {
        "name": NAME,
        "description": DESCRIPTION,
        "icon": "mdi-compass-outline",
        "company": NAME,
        "version": calib.__version__,
        "webpage": ".",
        "api": "docs",
        "route": "",
        "new_page": False,
        "extra_query": "",
        "avoid_iframes": False,
        "works_in_relative_paths": True,
        "extras": {"cockpit": EXTRAS},
    }


def cockpit_manifest() -> dict[str, Any]:
    """Widgets and actions for Cockpit, every key in both spellings."""
    widget = {
        "name": "Calibration of the sensors",
        "configType": "iframe",
        "iframeUrl": f"/{COMPASS_WIDGET}",
        "iframeIcon": "/panel/icon.svg",
        "iconUrl": "/panel/icon.svg",
        "version": calib.__version__,
        "startCollapsed": True,
        "useExtensionPathAsBaseUrl": True,
    }
    found: dict[str, Any] = both_spellings(
        {
            "targetSystem": "Cockpit",
            "targetCockpitApiVersion": "1.0.0",
            "widgets": [widget],
            "actions": [],
            "joystickSuggestions": [],
        }
    )
    return found


def both_spellings(value: Any) -> Any:
    """`value` with each key in camel case once more in snake case."""
    if isinstance(value, dict):
        made = {key: both_spellings(part) for key, part in value.items()}
        return made | {_snake(key): part for key, part in made.items()}
    return [both_spellings(part) for part in value] if isinstance(value, list) else value


def _snake(key: str) -> str:
    return re.sub(r"(?<=[a-z0-9])([A-Z])", lambda found: f"_{found[1].lower()}", key)
