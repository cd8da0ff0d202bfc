"""Scenario of size: a page of a run of 198,000 trials, and of a week of events, has no element for each of them."""

import json
from datetime import datetime, timedelta, timezone

from person import LIMIT_MS, URL, api, until
from views import pages

TRIALS, EVENTS = 198_000, 20_160  # One event each half minute of a week.
# Fewer than the run has configurations, 18,000; a page has a few hundred to a few thousand.
NODES_MOST = 6000
# Rows of a page of the list of trials, and more than that are stored.
ROWS, STORED = 50, 60
SETTLE_MS = 3000
# Pages that settle at the same time.
TOGETHER = 4
NODES = "document.querySelectorAll('*').length"


def size(page, browser):
    """Counts the elements of every page while the paper's campaign is under way, and again when it has continued."""
    run = begun("real-hex")
    assert run["trials_planned"] == TRIALS, run
    more_trials()
    page.goto(URL)
    number = run["scan_id"]
    paths = [view.path for view in pages(page)]
    paths += [f"/{name}?run={number}" for name in ("plan", "runs", "trials")]
    counts = {}
    for first in range(0, len(paths), TOGETHER):
        counts |= nodes(browser, paths[first:first + TOGETHER])
    print(counts)
    assert max(counts.values()) < NODES_MOST, counts
    page.goto(f"{URL}/trials")
    page.wait_for_timeout(SETTLE_MS)
    assert page.locator(".page-trials tbody tr:not(.u-series)").count() == ROWS
    a_week_of_events(page)
    page.goto(f"{URL}/?log=all")
    counts = [page.evaluate(NODES)]

    def same():
        more_trials()
        counts.append(page.evaluate(NODES))
        return max(counts) < NODES_MOST and counts[-1] < counts[-2] + STORED

    # Its charts are made with their first numbers, some seconds later.
    until("a page that does not grow with the trials", same)
    print(f"night with {EVENTS} events: {counts} elements, each count {STORED} trials after the one before")


def more_trials():
    """Waits until STORED more trials are stored."""
    stored = lambda: (api("/status")["run"] or {}).get("trials_stored", 0)
    before = stored()
    return until("more trials", lambda: stored() > before + STORED)


def begun(name):
    """Queues a carried experiment and starts it."""
    item = next(one for one in api("/experiments")["items"] if one["name"] == name)
    run = api("/queue", {"file": item["file"], "definition": item["text"], "who": "test"})
    code = api(f"/runs/{run['uid']}/arm", {"who": "test"})["code"]
    api(f"/runs/{run['uid']}/actions", {"action": "start", "code": code, "who": "test"})
    return run


def nodes(browser, paths):
    """Number of elements of pages that are open at the same time, each in a context with its own connections."""
    contexts = [browser.new_context(viewport={"width": 1400, "height": 900}) for _ in paths]
    opened = [context.new_page() for context in contexts]
    for one, path in zip(opened, paths):
        one.goto(URL + path, timeout=LIMIT_MS)
    opened[-1].wait_for_timeout(SETTLE_MS)
    # A page that is not visible does not draw.
    assert all(one.evaluate("document.visibilityState") == "visible" for one in opened)
    counts = {path: one.evaluate(NODES) for one, path in zip(opened, paths)}
    for context in contexts:
        context.close()
    return counts


def a_week_of_events(page):
    """The page receives the events of a week at once; what follows is the service's."""
    now, sent = datetime.now(timezone.utc), []
    event = lambda n: {"seq": n, "run": None, "kind": "reference", "data": {"before": n},
                       "importance": "routine", "words": f"reference press before configuration {n}",
                       "at": (now - timedelta(seconds=30 * (EVENTS - n))).isoformat()}
    body = "".join(f"id: {n}\ndata: {json.dumps(event(n))}\n\n" for n in range(1, EVENTS + 1))

    def answer(route):
        if "text/event-stream" not in route.request.headers.get("accept", "") or sent:
            return route.continue_()
        sent.append(True)
        return route.fulfill(status=200, content_type="text/event-stream", body=body)

    page.route("**/api/v1/events?*", answer)
