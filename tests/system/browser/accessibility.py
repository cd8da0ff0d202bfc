"""Scenarios with axe: no serious fault on any page, opened item, dialog or state, at a desk and on a phone, light and dark."""

from axe_playwright_python.sync_playwright import Axe

import views
from person import URL, api

# Severities of axe that fail.
SERIOUS = ("serious", "critical")
# Off by default; a finger needs it.
OPTIONS = {"resultTypes": ["violations"], "rules": {"target-size": {"enabled": True}}}
LIGHTS = ("light", "dark")
DESK, PHONE = {"width": 1400, "height": 900}, {"width": 390, "height": 844}
REDRAWN_MS = 500
# Pages that show a broken state in their own way; of the others only the bar does, which these have too.
OWN_STATES = ("/", "/rig", "/live", "/place")
# Faults of Swagger UI 5.35 itself, which is an unchanged file of another author (web/vendor). Its tracker has the first
# three, open. They count on every other element of the page, and all other rules count on Swagger UI as well.
SWAGGER = {
    "color-contrast": "colours of methods, types and buttons ('WCAG 2.1 1.4.3 -- Insufficient Color Contrast')",
    "nested-interactive": "the line of an operation is a button that holds buttons",
    "scrollable-region-focusable": "an example that is longer than its box is not reached by keys",
    "target-size": "links and marks of an operation are smaller than a finger",
}
IN_SWAGGER = "selector => document.querySelector(selector)?.closest('.swagger-ui') != null"


def axe(page, browser):
    """Every page as it is, what is opened on it, dialogs and forms; the pages tripped, halted, with a full disk, and lost."""
    page.goto(URL)
    pages = views.pages(page)
    items = [*views.opened(api), *views.DOCS, *views.DIALOGS, *views.FORMS]
    looked_at = [(view, "busy", (DESK, PHONE)) for view in pages] + [(view, "busy", (DESK,)) for view in items] + [
        (view, state, (DESK,)) for state in views.BROKEN for view in pages if view.path in OWN_STATES]
    nothing_serious(browser, looked_at)


def axe_empty(page, browser):
    """Every page of a service that has no run yet, whose rig is not connected."""
    assert not api("/runs")["items"] and api("/status")["rig"]["state"] == "disconnected"
    page.goto(URL)
    nothing_serious(browser, [(view, "busy", (DESK, PHONE)) for view in views.pages(page)])


def nothing_serious(browser, looked_at):
    """Looks at views in their states and sizes; a size is that of the same page, whose content follows it."""
    found, met = [], set()
    for view, state, sizes in looked_at:
        with views.shown(browser, URL, view, state, viewport=sizes[0], color_scheme=LIGHTS[0]) as (one, errors):
            found += [f"{view.name}, {state}: {error}" for error in errors]
            for size in sizes:
                one.set_viewport_size(size)
                for light in LIGHTS:
                    if (size, light) != (sizes[0], LIGHTS[0]):  # The view has settled in these.
                        one.emulate_media(color_scheme=light)
                        one.wait_for_timeout(REDRAWN_MS)
                    where = f"{view.name}, {state}, {size['width']} px, {light}"
                    found += [f"{where}: {fault}" for fault in faults(one, view, met)]
    print(f"{len(looked_at)} views; rules of Swagger UI that were met: {sorted(met)} of {sorted(SWAGGER)}")
    assert not found, "\n".join(found)


def faults(page, view, met):
    """The serious faults of a page; those of Swagger UI are noted in `met`."""
    for fault in Axe().run(page, options=OPTIONS).response["violations"]:
        if fault["impact"] not in SERIOUS:
            continue
        for node in fault["nodes"]:
            if view.is_docs and fault["id"] in SWAGGER and page.evaluate(IN_SWAGGER, node["target"][0]):
                met.add(fault["id"])
            else:
                yield f"{fault['id']}: {node['target']}"
