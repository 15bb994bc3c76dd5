"""A browser for tests of pages: Debian's chromium, without a network. Every complaint of a page fails the test."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

#: Time limit for the browser in ms. It only catches a browser that hangs.
HUNG = 300_000


@contextmanager
def opened(address, width=1200, scheme="light", offline=True) -> Iterator:
    """Open a page in chromium. The test fails if the page has an error, writes a warning or loads anything else.

    The test is skipped where no chromium is installed. `offline` is False for a page of a server on this machine.
    """
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("no chromium is installed")
    from playwright.sync_api import sync_playwright

    complaints = []

    def requested(request):
        if offline and request.url != address and not request.url.startswith(("data:", "blob:")):
            complaints.append(f"asks for {request.url}")

    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=chromium, args=["--no-sandbox"], timeout=HUNG)
        page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
        page.set_default_timeout(HUNG)
        page.on("pageerror", lambda error: complaints.append(f"error: {error}"))
        page.on("console", lambda said: said.type in ("error", "warning") and complaints.append(said.text))
        page.on("request", requested)
        page.goto(address)
        yield page
        browser.close()
    assert not complaints, complaints


def violations(page) -> list[str]:
    """List the findings of axe-core in a page that are serious or critical: the rule and the elements."""
    from axe_playwright_python.sync_playwright import Axe

    found = Axe().run(page).response["violations"]
    return [
        f"{rule['id']}: {[node['html'][:120] for node in rule['nodes'][:3]]}"
        for rule in found
        if rule["impact"] in ("serious", "critical")
    ]
