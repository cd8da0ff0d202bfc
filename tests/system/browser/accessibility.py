"""Scenarios with axe: no serious fault on any page, opened item, dialog or state, at a desk and on a phone, light and dark.

Light and dark differ in colours alone: all rules run in light, those that read colours also in dark.
"""

from axe_playwright_python.sync_playwright import Axe

import views
from person import URL, api

# Severities of axe that fail.
SERIOUS = ("serious", "critical")
VIOLATIONS = "options => axe.run(document, options).then(found => found.violations)"
# Off by default; a finger needs it.
ALL_RULES = {"resultTypes": ["violations"], "rules": {"target-size": {"enabled": True}}}
COLOURS = {"resultTypes": ["violations"], "runOnly": {"type": "rule", "values": ["color-contrast", "link-in-text-block"]}}
LIGHTS = {"light": ALL_RULES, "dark": COLOURS}
DESK, PHONE = {"width": 1400, "height": 900}, {"width": 390, "height": 844}
REDRAWN_MS = 500
# Without transitions, as our pages are, other colours are there with the next frame. Chromium may draw none for a page
# that nobody sees.
NEXT_FRAME = ("new Promise(done => { requestAnimationFrame(() => requestAnimationFrame(done)); "
              "setTimeout(done, 2000) }).then(() => {})")
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
IN_SWAGGER = "all => all.map(selector => document.querySelector(selector)?.closest('.swagger-ui') != null)"


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
    """Looks at views in their states and sizes, first at a desk; a size is that of the same page, whose content follows
    it."""
    found, met = [], set()
    look = {"viewport": DESK, "color_scheme": "light"}
    # Its pages share the scripts; what is changed before a view would stay in it.
    context = browser.new_context(**look)
    for view, state, sizes in looked_at:
        place, of_place = (context, {}) if view.before is views.nothing else (browser, look)
        with views.shown(place, URL, view, state, **of_place) as (one, errors):
            found += [f"{view.name}, {state}: {error}" for error in errors]
            one.evaluate(Axe().axe_script)
            for size in sizes:
                if size != DESK:  # The view has settled at the desk.
                    one.set_viewport_size(size)
                    one.evaluate(NEXT_FRAME)
                for light, rules in LIGHTS.items():
                    one.emulate_media(color_scheme=light)
                    one.wait_for_timeout(REDRAWN_MS) if view.is_docs else one.evaluate(NEXT_FRAME)
                    where = f"{view.name}, {state}, {size['width']} px, {light}"
                    found += [f"{where}: {fault}" for fault in faults(one, view, rules, met)]
    print(f"{len(looked_at)} views; rules of Swagger UI that were met: {sorted(met)} of {sorted(SWAGGER)}")
    assert not found, "\n".join(found)


def faults(page, view, rules, met):
    """The serious faults of a page by these rules; those of Swagger UI are noted in `met`."""
    for fault in page.evaluate(VIOLATIONS, rules):
        if fault["impact"] not in SERIOUS:
            continue
        targets = [node["target"] for node in fault["nodes"]]
        known = view.is_docs and fault["id"] in SWAGGER
        others = page.evaluate(IN_SWAGGER, [target[0] for target in targets]) if known else [False] * len(targets)
        for target, is_of_another in zip(targets, others):
            if is_of_another:
                met.add(fault["id"])
            else:
                yield f"{fault['id']}: {target}"
