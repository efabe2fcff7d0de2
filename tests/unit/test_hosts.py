"""How host systems find the service."""

from __future__ import annotations

from mavcal.service.hosts import both_spellings, cockpit_manifest, registration


def test_every_key_is_there_in_both_spellings():
    told = both_spellings({"iframeUrl": [{"startCollapsed": 1}], "name": "aB", "targetCockpitApiVersion": 2})
    assert told == {
        "iframeUrl": [{"startCollapsed": 1, "start_collapsed": 1}],
        "iframe_url": [{"startCollapsed": 1, "start_collapsed": 1}],
        "name": "aB",
        "targetCockpitApiVersion": 2,
        "target_cockpit_api_version": 2,
    }


def test_the_manifest_is_where_the_registration_says():
    assert registration()["extras"]["cockpit"] == "/cockpit_extras.json"
    [widget] = cockpit_manifest()["widgets"]
    assert widget["iframe_url"] == widget["iframeUrl"]
    assert widget["version"] == registration()["version"]
