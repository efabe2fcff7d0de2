"""Rules that hold in every room: accessibility as axe-core judges it, and the content-security policy."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from urllib.request import urlopen

import pytest

from mavcal.client import Client
from tests.ui.rooms import capturing, furnish

from .panel import PHONE, Panel, service, until

AXE = Path(__file__).parent / "vendor" / "axe.min.js"
GRAVE = ("serious", "critical")
THEMES = ("light", "dark", "sunlight")
JUDGED = """async () => (await axe.run(document, {resultTypes: ['violations']})).violations.map(v =>
    ({rule: v.id, impact: v.impact,
      where: v.nodes.map(n => n.target.join(' ') + ': ' + n.failureSummary).slice(0, 4)}))"""
REPORTED = """addEventListener('securitypolicyviolation', e =>
    (window.refused ??= []).push(`${e.violatedDirective} ${e.blockedURI}`))"""
PAGES = ("", "docs", "openapi.json", "panel/main.js", "api/v1/jobs", "no-such-page")

pytestmark = [pytest.mark.timeout(600), pytest.mark.long]


@dataclass(frozen=True)
class Furnished:
    client: Client
    url: str
    rooms: Mapping[str, str]

    def places(self) -> Iterator[tuple[str, str]]:
        """Every room and its place; the job in capture runs when it is looked at."""
        for room, place in self.rooms.items():
            if room in {"capture", "live"}:
                vehicle = self.rooms["live"].split("/")[2]
                job = capturing(self.client, vehicle)
                place = f"#/job/{job}" if room == "capture" else place
            yield room, place


@pytest.fixture(scope="module")
def furnished(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Furnished]:
    """A service whose rooms all have something to show."""
    with service(tmp_path_factory.mktemp("rules")) as url, Client(url) as client:
        yield Furnished(client, url, furnish(client))


def shown(panel: Panel, room: str) -> None:
    """Wait until the room has what it asks the service for."""
    panel.sees("Live", inside=".connection")
    panel.page.wait_for_selector(READY[room])
    panel.page.wait_for_timeout(300)


READY = {
    "home": ".tile",
    "vehicle": ".tile",
    "preflight": "main button.primary",
    "about": "#name",
    "live": ".charts figure",
    "capture": ".faces li",
    "campaign": ".campaign tbody tr",
    "review": ".before-after img",
    "logs": ".jobs li",
    "log": "#method",
    "gap": ".drop",
    "diagnosis": "iframe.report",
    "history": "main table, .rows .row",
    "setup": "#url",
}
"""Text that a room shows once it is complete."""


@pytest.mark.skipif(not AXE.is_file(), reason="axe-core is not here: scripts/vendor dev brings it")
@pytest.mark.parametrize("theme", THEMES)
def test_no_room_has_a_serious_fault_of_accessibility(browser, furnished, theme):
    panel = Panel(browser)
    faults: dict[str, object] = {}
    for size in (None, PHONE):
        if size is not None:
            panel.page.set_viewport_size(size)
        panel.open(furnished.url)
        panel.page.evaluate("name => localStorage.setItem('mavcal-theme', name)", theme)
        for room, place in furnished.places():
            panel.open(furnished.url, place)
            panel.page.reload()
            shown(panel, room)
            assert panel.page.evaluate("document.documentElement.dataset.theme") == theme
            panel.page.evaluate(AXE.read_text(encoding="utf-8"))
            found = [fault for fault in panel.page.evaluate(JUDGED) if fault["impact"] in GRAVE]
            if found:
                faults[f"{room} {'phone' if size else 'desk'}"] = found
    panel.close()
    assert faults == {}


def test_every_page_has_a_policy_without_inline_scripts_or_styles(furnished):
    for page in PAGES:
        try:
            headers = urlopen(f"{furnished.url}{page}").headers
        except OSError as refused:
            headers = refused.headers  # type: ignore[attr-defined]
        policy = headers["Content-Security-Policy"]
        assert "default-src 'self'" in policy, page
        assert "unsafe" not in policy, page


def test_no_room_breaks_the_policy(browser, furnished):
    panel = Panel(browser)
    panel.page.add_init_script(REPORTED)
    refused: dict[str, object] = {}
    for room, place in furnished.places():
        panel.open(furnished.url, place)
        panel.page.reload()
        shown(panel, room)
        if room == "live":
            panel.press("Noise spectrum")
            panel.page.wait_for_timeout(500)
        if found := panel.page.evaluate("window.refused ?? []"):
            refused[room] = found
    panel.open(f"{furnished.url}docs")
    panel.sees("/healthz", inside="#interface")
    if found := panel.page.evaluate("window.refused ?? []"):
        refused["docs"] = found
    assert refused == {}
    assert not any("Content Security Policy" in said for said in panel.complaints), panel.complaints
    panel.close()


def test_the_policy_refuses_what_a_page_may_not_do(browser, furnished):
    """The listener hears: else the test above would pass on a page without a policy."""
    panel = Panel(browser)
    panel.page.add_init_script(REPORTED)
    panel.open(furnished.url)
    panel.page.evaluate("document.body.append(Object.assign(document.createElement('style'), {textContent: 'p {}'}))")
    until(lambda: panel.page.evaluate("window.refused ?? []") != [], 20, "the listener hears")
    panel.close()
