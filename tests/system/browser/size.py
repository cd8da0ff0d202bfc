"""Scenario of size: a page of a run of 198,000 trials, and of a week of events, has no element for each of them."""

import json
from datetime import datetime, timedelta, timezone

from person import URL, api, until
from views import pages

TRIALS, EVENTS = 198_000, 20_160  # One event each half minute of a week.
# Fewer than the run has configurations, 18,000; a page has a few hundred to a few thousand.
NODES_MOST = 6000
# Rows of a page of the list of trials, and more than that are stored.
ROWS, STORED = 50, 60
SETTLE_MS = 3000
NODES = "document.querySelectorAll('*').length"


def size(page, _browser):
    """Counts the elements of every page while the paper's campaign is under way, and again when it has continued."""
    run = begun("real-hex")
    assert run["trials_planned"] == TRIALS, run
    more_trials()
    page.goto(URL)
    number = run["scan_id"]
    paths = [view.path for view in pages(page)]
    paths += [f"/{name}?run={number}" for name in ("plan", "runs", "trials")]
    counts = {path: nodes(page, path) for path in paths}
    print(counts)
    assert max(counts.values()) < NODES_MOST, counts
    page.goto(f"{URL}/trials")
    page.wait_for_timeout(SETTLE_MS)
    assert page.locator(".page-trials tbody tr:not(.u-series)").count() == ROWS
    a_week_of_events(page)
    nodes(page, "/?log=all")
    # Its charts are made with their first numbers, some seconds later.
    before, after = (page.evaluate(NODES) for _ in range(2) if more_trials())
    print(f"night with {EVENTS} events: {before} elements, {after} after {STORED} more trials")
    assert max(before, after) < NODES_MOST and after < before + STORED, (before, after)


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


def nodes(page, path):
    """Number of elements of a page."""
    page.goto(URL + path)
    page.wait_for_timeout(SETTLE_MS)
    return page.evaluate(NODES)


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
