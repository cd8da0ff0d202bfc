"""What there is to look at in the dashboard: pages, what is opened on them, dialogs, and the states that break them.

The tests with axe and the pictures (`tests/figures/screens.py`) go through the same list. A state changes what the
browser receives, or cuts its connection: nothing happens to the rig. Of the dialogs none is confirmed.
"""

import json
import os
import re
import shutil
import time
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Callable

from wire import Wire

PAGES = "import('/web/pages.js').then(m => m.PAGES.map(({ name }) => [name, name === m.FIRST ? '/' : `/${name}`]))"
LIMIT_MS = 60_000
# In the page: ms from the newest status to the moment at which it is shown as old.
LOST = """globalThis.palpateLost = new Promise(told => import('/web/lib/live.js').then(({ live }) => {
  live.addEventListener('fresh', () => live.fresh || told(Date.now() - live.at)) })); 0"""
# An operation of the API that has parameters and several answers, at the address that Swagger UI gives it.
OPERATION = "/docs#/runs/run"


def nothing(_page):
    """Changes nothing."""


@dataclass(frozen=True)
class View:
    """Something to look at: name, address, what is changed before it is opened, and what opens it afterwards."""

    name: str
    path: str
    before: Callable = nothing
    open: Callable = nothing

    @property
    def is_docs(self):
        """Whether it is a page of Swagger UI."""
        return self.path.startswith("/docs")


# --- What the browser is told -------------------------------------------------------------------------


def with_status(change):
    """Lets a page receive only changed statuses: without its socket it asks for them."""

    def changed(route):
        answer = route.fetch()
        status = answer.json()
        if isinstance(status, dict) and "rig" in status:
            change(status)
        route.fulfill(response=answer, body=json.dumps(status))

    def before(page):
        page.route_web_socket("**/status/live*", lambda socket: socket.close())
        page.route("**/api/v1/status", changed)

    return before


def asked_of_run(status, *possible, why="the run is paused"):
    """The active run allows these actions; it refuses all others."""
    for one in status["run_actions"]:
        one["refused"] = None if one["action"] in possible else f"{one['action']} is not possible: {why}"


def needs(status, *found, safe=None, data=None):
    """A person must do this: kind, words and page of each; what the glance says of safety and data."""
    status["needs"] = [{"kind": kind, "importance": "act", "words": words, "command": None, "page": page, "since": None}
                       for kind, words, page in found]
    for one in status["glance"]:
        bad = {"safe": safe, "data": data}.get(one["question"])
        if bad:
            one.update(rating="bad", words=bad)


def tripped(status):
    """A force was beyond its limit."""
    status["rig"].update(state="tripped", trip={"kind": "force", "detail": "cell 3 reads 91.4 N, limit 88.0 N"})
    for one in status["rig_actions"]:
        if one["action"] in ("home", "jog"):
            one["refused"] = f"{one['action']} is not possible while the rig is tripped: check and reset it first"
        elif one["action"] in ("tare", "tips", "reset", "disconnect"):
            one["refused"] = None
    if status["run"]:
        status["run"].update(state="paused", paused_why="trip", requested_state=None)
        asked_of_run(status, "pause", "stop", "abort", why="the rig is tripped: reset, home")
    trip = "cell 3 reads 91.4 N, limit 88.0 N."
    needs(status, ("reset", f"Tripped (force): {trip} Clear the cause, reset, then home.", "rig"),
          safe="Stopped by a fault (force).")


def halted(status):
    """An e-stop is latched, an axis is not stopped, and what was queued does not begin by itself."""
    stop = {"acknowledged_ms": 3.1, "stood_ms": 162.0, "error": None}
    silent = {"acknowledged_ms": None, "stood_ms": None, "error": "no reply within 200 ms"}
    status["rig"].update(
        state="tripped", trip={"kind": "estop", "detail": "emergency stop (Ada (local))"}, estop_acknowledged_ms=None,
        estop_stops=[{"axis": axis, **(silent if axis == "y" else stop)} for axis in ("x", "y", "z", "radial")])
    for one in status["rig_actions"]:
        one["refused"] = "an axis has not acknowledged its stop: y"
    words = "run 3 (real-random) does not begin by itself: the rig tripped (estop): start it again"
    status.update(run=None, suspenders=[], last_trial_at=None, waiting_for=words, not_begun=words)
    moving = "NOT STOPPED: y (no reply within 200 ms)."
    needs(status, ("not_stopped", f"{moving} The stop is sent again until it is. Use the button on the rig.", "rig"),
          ("reset", "Tripped (estop): emergency stop (Ada (local)). Clear the cause, reset, then home.", "rig"),
          ("start", f"R{words[1:]}.", "queue"), safe=f"{moving} Use the button on the rig.")


def disk_full(status):
    """The disk has no room for the remaining trials, and the run is suspended."""
    free, needed = 90_000_000, 4_200_000_000
    status["disk"] = {"free_bytes": free, "needed_bytes": needed}
    for one in status["suspenders"]:
        if one["name"] == "disk":
            one.update(value=free, threshold=needed, since=status["service"]["started_at"])
    if status["run"]:
        status["run"].update(state="paused", paused_why="suspender", requested_state=None,
                             waiting_for="the disk has 90 MB free, the run needs 4.2 GB")
        asked_of_run(status, "start", "resume", "stop", "abort")
        waits = "The run waits: something that watches the run suspended it: the disk has 90 MB free, the run needs 4.2 GB."
        needs(status, ("resume", waits, "night"), data="Beyond its limit: free disk. The disk is short of 4.11 GB.")


ASKED = [{"number": 1, "x_mm": 150.0, "y_mm": 190.0, "force_n": 7.358, "point": "R7 C5"},
         {"number": 2, "x_mm": 380.0, "y_mm": 400.0, "force_n": 4.905, "point": "R16 C14"}]
FELT = [{"x_mm": 153.0, "y_mm": 186.0, "force_n": 7.1}, {"x_mm": 290.0, "y_mm": 300.0, "force_n": 5.2}]
PLACEMENT = {
    "run": "1", "scan_id": 1, "experiment": "real-random", "trial": 41, "of": 150, "done": 41, "repeated": 2, "contacts": ASKED,
    "stage": "place", "at_rest": True, "felt": {"method": "exact", "model": "cal-0", "contacts": FELT},
    "verdict": {"kind": "wrong", "words": ["weight 2 (0.50 kg), asked at R16 C14, is felt 135 mm away, near R12 C11"],
                "matches": [{"asked": 1, "felt": 0, "distance_mm": 5.0, "force_n": 7.1},
                            {"asked": 2, "felt": 1, "distance_mm": 134.5, "force_n": 5.2}]},
    "last": {"trial": 40, "trial_id": 1, "verdict": "right"},
}


def asks(status):
    """The active run asks for weights."""
    if status["run"]:
        contacts = [{key: one[key] for key in ("x_mm", "y_mm", "force_n")} for one in ASKED]
        status["run"].update(state="paused", paused_why="manual_trial", requested_state=None,
                             waiting_for="place 2 weights", wanted={"trial": PLACEMENT["trial"], "contacts": contacts})
        asked_of_run(status, "start", "confirm", "repeat", "stop", "abort")
        needs(status, ("weights", "Weights must be placed: place 2 weights.", "place"))


def wrong_weight(page):
    """A run asks for two weights, and the skin feels the second one on another point."""
    named(page)
    answer = {**PLACEMENT, "untouched_at": datetime.now(timezone.utc).isoformat()}
    page.route("**/api/v1/placement", lambda route: route.fulfill(json=answer))
    with_status(asks)(page)


def named(page):
    """The browser knows the name of the person."""
    page.add_init_script("localStorage.setItem('palpate-who', 'Ada')")


def with_key(secret):
    """The tab sends this key."""
    return lambda page: page.add_init_script(f"sessionStorage.setItem('palpate-key', {json.dumps(secret)})")


# --- What is looked at --------------------------------------------------------------------------------


def pages(page):
    """Every page; `page` shows one of them."""
    return [View(name, path) for name, path in page.evaluate(PAGES)]


def waits_for(selector):
    """Waits until the page shows an element."""
    return lambda page: page.locator(selector).first.wait_for(timeout=LIMIT_MS)


def asks_by(words):
    """Presses the first button whose name begins like this, which opens a dialog."""

    def press(page):
        page.get_by_role("button", name=re.compile(f"^{words}")).first.click(timeout=LIMIT_MS)
        waits_for("dialog[open]")(page)

    return press


def asks_for_help(page):
    """Opens the list of keys."""
    page.keyboard.press("?")
    waits_for("dialog[open]")(page)


# They need a run that is active, one that is queued, and a net that does not serve.
DIALOGS = [
    View("dialog-keys", "/", open=asks_for_help),
    View("dialog-name", "/settings", open=asks_by("Take the lock")),
    View("dialog-abort", "/", before=named, open=asks_by("Abort")),
    View("dialog-start", "/queue", before=named, open=asks_by("Arm and start")),
    View("dialog-remove", "/queue", before=named, open=asks_by("Remove")),
    View("dialog-promote", "/nets", before=named, open=asks_by("Promote")),
]
DOCS = [View("docs", "/docs", open=waits_for(".opblock-tag")),
        View("docs-operation", OPERATION, open=waits_for(".opblock.is-open"))]
# The page asks for a key; a weight is wrong while a run asks for it.
FORMS = [View("key", "/", before=with_key("wrong"), open=waits_for("#key-form")),
         View("wrong-weight", "/place", before=wrong_weight, open=waits_for(".verdict.bad"))]


def opened(get):
    """What can be opened with the data of a service; `get` returns the JSON of a path of its API."""
    runs = [run for run in get("/runs")["items"] if run["state"] not in ("queued", "removed")]
    ended = [run["scan_id"] for run in runs if run["state"] == "ended"]
    numbers = ended + [run["scan_id"] for run in runs if run["scan_id"] not in ended]
    trial, dataset, net, job, queued = (next(iter(get(path)["items"]), None) for path in (
        "/trials?limit=1", "/datasets?limit=1", "/models?limit=1", "/jobs?limit=1", "/queue"))
    found = {"new-run": "/queue?add=quickstart", "offer": "/plan?experiment=quickstart",
             "touched": "/model?contacts=270,280,20n;150,150,1.5mm"}
    if trial:
        found["trial"] = f"/trials?trial={trial['trial_id']}"
        found["trial-in-model"] = f"/model?trial={trial['trial_id']}"
    if ended:
        found["report"], found["step"] = f"/runs?run={ended[0]}", f"/plan?run={ended[0]}&step=3"
    if len(numbers) > 1:
        found["comparison"] = f"/runs?run={numbers[0]}&with={numbers[1]}"
    if dataset:
        found["dataset"] = f"/data?dataset={dataset['name']}"
        runs_of = get(f"/datasets/{dataset['id']}/lineage")["lineage"]["runs"]
        for run in [one["scan_id"] for one in runs_of][:1]:
            of = get(f"/trials?scan_id={run}&limit=1")["items"][0]["trial_id"]
            found["lineage"] = f"/data?dataset={dataset['name']}&run={run}&trial={of}"
    if net:
        found["net"] = f"/nets?model={net['id']}"
    if job:
        found["job"] = f"/nets?job={job['id']}"
    if queued:
        found["editor"] = f"/queue?edit={queued['scan_id']}"
    return [View(name, path) for name, path in found.items()]


# --- How it is shown ----------------------------------------------------------------------------------

# States in which the browser is told something else; `lost` cuts the connection of a page that was shown.
BROKEN = {"tripped": with_status(tripped), "halted": with_status(halted), "disk": with_status(disk_full), "lost": nothing}


def launched(playwright, *more):
    """Headless Chromium, with more options."""
    chromium = os.environ.get("PALPATE_CHROMIUM", "chromium")
    return playwright.chromium.launch(
        executable_path=chromium if os.path.sep in chromium else shutil.which(chromium),
        args=["--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", *more])


@contextmanager
def shown(browser, url, view, state="busy", settle_ms=None, **look):
    """Opens a view in a state; yields the page, settled, and the errors that it wrote until then. `browser` may be a
    context; otherwise the page has a new one with this `look`.

    It has settled once it is `quiet`, or after `settle_ms`.
    """
    wire = Wire(url) if state == "lost" else None
    page = browser.new_page(**look)
    page.set_default_timeout(LIMIT_MS)
    errors, waiting = watched(page), unanswered(page)
    try:
        view.before(page)
        BROKEN.get(state, nothing)(page)
        page.goto((wire.url if wire else url) + view.path, wait_until="domcontentloaded")
        waits_for("#docs .info" if view.is_docs else "main h1")(page)
        page.wait_for_timeout(settle_ms) if settle_ms else quiet(page, waiting)
        view.open(page)
        written = list(errors)
        if wire:
            wire.cut()
            waits_for("#gone:not([hidden])")(page)
        yield page, written
    finally:
        page.unroute_all(behavior="ignoreErrors")
        page.close()
        if wire:
            wire.close()


def unanswered(page):
    """The requests that a page waits for, kept up to date; streams of events, which do not end, are left out."""
    waiting = set()
    page.on("request", lambda one: "event-stream" in one.headers.get("accept", "") or waiting.add(one))
    for over in ("requestfinished", "requestfailed"):
        page.on(over, lambda one: waiting.discard(one))
    return waiting


def quiet(page, waiting, for_ms=400, most_ms=1500):
    """Waits until a page has waited for no answer for this long; one that requests again and again, at most so long."""
    now = time.monotonic()
    since, ends = now, now + most_ms / 1000
    while now < ends and now < since + for_ms / 1000:
        page.wait_for_timeout(25)
        now = time.monotonic()
        if waiting:
            since = now


def watched(page):
    """The list of errors that a page writes; an answer that a page requested in vain is none."""
    errors = []
    page.on("pageerror", lambda error: errors.append(str(error)))

    def console(message):
        is_refusal = "Failed to load resource" in message.text or "WebSocket" in message.text
        if message.type == "error" and not is_refusal:
            errors.append(message.text)

    page.on("console", console)
    return errors
