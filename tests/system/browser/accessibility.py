"""Scenario with axe: no serious fault on any page, opened item, dialog or state, light and dark."""

from axe_playwright_python.sync_playwright import Axe

import views
from person import URL, api

# Severities of axe that fail.
SERIOUS = ("serious", "critical")
LIGHTS = ("light", "dark")
REDRAWN_MS = 500
# Pages that show a broken state in their own way; of the others only the bar does, which these have too.
OWN_STATES = ("/", "/rig", "/live", "/place")
# Faults of Swagger UI 5.35 itself, which is an unchanged file of another author (web/vendor). Its tracker has them,
# open. They count on every other element of the page, and all other rules count on Swagger UI as well.
SWAGGER = {
    "color-contrast": "colours of methods, types and buttons ('WCAG 2.1 1.4.3 -- Insufficient Color Contrast')",
    "nested-interactive": "the line of an operation is a button that holds buttons",
    "scrollable-region-focusable": "an example that is longer than its box is not reached by keys",
}
IN_SWAGGER = "selector => document.querySelector(selector)?.closest('.swagger-ui') != null"


def axe(page, browser):
    """Every page as it is, what is opened on it, dialogs and forms; the pages tripped, with a full disk, and lost."""
    page.goto(URL)
    pages = views.pages(page)
    items = [*pages, *views.opened(api), *views.DOCS, *views.DIALOGS, *views.FORMS]
    looked_at = [(view, "busy") for view in items] + [(view, state) for state in views.BROKEN for view in pages
                                                     if view.path in OWN_STATES]
    found, met = [], set()
    for view, state in looked_at:
        size = {"width": 1400, "height": 900}
        with views.shown(browser, URL, view, state, viewport=size, color_scheme=LIGHTS[0]) as (one, errors):
            found += [f"{view.name}, {state}: {error}" for error in errors]
            for light in LIGHTS:
                if light != LIGHTS[0]:  # The view has settled in this one.
                    one.emulate_media(color_scheme=light)
                    one.wait_for_timeout(REDRAWN_MS)
                found += [f"{view.name}, {state}, {light}: {fault}" for fault in faults(one, view, met)]
    print(f"{len(looked_at)} views; rules of Swagger UI that were met: {sorted(met)} of {sorted(SWAGGER)}")
    assert not found, "\n".join(found)


def faults(page, view, met):
    """The serious faults of a page; those of Swagger UI are noted in `met`."""
    for fault in Axe().run(page).response["violations"]:
        if fault["impact"] not in SERIOUS:
            continue
        for node in fault["nodes"]:
            if view.is_docs and fault["id"] in SWAGGER and page.evaluate(IN_SWAGGER, node["target"][0]):
                met.add(fault["id"])
            else:
                yield f"{fault['id']}: {node['target']}"
