"""Scenario of a connection that is lost: the page reports it, old values are grey, and it heals by itself."""

import re

from playwright.sync_api import expect

from person import URL, state
from views import LOST
from wire import Wire

GREY = "[...document.querySelectorAll('main .live, #bar-state')].map(one => getComputedStyle(one).filter !== 'none')"


def lost(page, _browser):
    """The service is killed, then the network is silent: both are shown, and both heal without a reload."""
    wire = Wire(URL)
    page.goto(wire.url)
    state(page, "running")
    lines = page.locator("html")
    # Something is read that may grow old.
    expect(page.locator("main .live").nth(3)).to_be_visible()
    for interrupt in (wire.cut, wire.silence):
        expect(lines).to_have_attribute("data-live", "yes")
        page.evaluate(LOST)
        interrupt()
        expect(page.locator("#gone")).to_be_visible()
        print(f"{interrupt.__name__}: shown {page.evaluate('palpateLost')} ms after the newest status")
        expect(lines).to_have_attribute("data-live", "no")
        assert all(grey := page.evaluate(GREY)) and len(grey) > 3, grey
        expect(page).to_have_title(re.compile("No connection"))
        old = page.locator("#bar-count").inner_text()
        if interrupt == wire.cut:
            stopped_in_vain(page)
        wire.mend()
        expect(lines).to_have_attribute("data-live", "yes")
        expect(page.locator("#gone")).to_be_hidden()
        assert not any(page.evaluate(GREY))
        expect(page.locator("#bar-count")).not_to_have_text(old)
        expect(page).not_to_have_title(re.compile("No connection"))
    wire.close()


def stopped_in_vain(page):
    """A stop that cannot arrive is not shown as one that did."""
    page.locator("#stop").click()
    expect(page.locator("#stop-said")).to_contain_text(re.compile("not confirmed", re.I))
