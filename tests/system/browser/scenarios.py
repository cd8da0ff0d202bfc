"""Scenarios in headless Chromium: python3 scenarios.py NAME URL CONTROL

A scenario does what a person does, with the words that are on the pages, and fails where the page does not answer.
CONTROL is the address of the virtual rig's control socket: the hands that place weights. PALPATE_CHROMIUM is the
browser, PALPATE_SCREENS the folder for a picture of the page that failed.
"""

import faulthandler
import os
import pathlib
import sys

from playwright.sync_api import expect, sync_playwright

import access
import accessibility
import bulk
import campaign
import connection
import person
import size
import touching
import views
import weighing

# Longest scenario, s: nothing else limits what is evaluated in a page. Where it stood is then printed.
LIMIT_S = 1800
SCENARIOS = {one.__name__: one for one in (
    campaign.first_evening, campaign.operate, campaign.abort, campaign.motion, campaign.keyboard, weighing.place,
    weighing.wrong_weight, touching.touch, access.viewer, connection.lost, accessibility.axe, accessibility.axe_empty,
    size.size, bulk.bulk)}


def main():
    """Runs a scenario."""
    name = sys.argv[1]
    faulthandler.dump_traceback_later(LIMIT_S, exit=True)
    expect.set_options(timeout=person.LIMIT_MS)
    with sync_playwright() as playwright:
        browser = views.launched(playwright)
        page = browser.new_context(viewport={"width": 1400, "height": 900}).new_page()
        page.set_default_timeout(person.LIMIT_MS)
        try:
            SCENARIOS[name](page, browser)
        except BaseException:
            pictures(browser, name)
            raise
        print(f"{name}: done")


def pictures(browser, name):
    """Keeps a picture of every page that is open."""
    folder = pathlib.Path(os.environ.get("PALPATE_SCREENS", "."))
    folder.mkdir(parents=True, exist_ok=True)
    for n, page in enumerate(page for context in browser.contexts for page in context.pages):
        file = folder / (f"{name}-{n}.png" if n else f"{name}.png")
        page.screenshot(path=file, full_page=True)
        print(f"{page.url}: the page as a picture is {file}", file=sys.stderr)


main()
