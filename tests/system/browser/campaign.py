"""Scenarios of a campaign: from nothing to data, the states of a run, its abort, and the stop without a mouse."""

import re

from playwright.sync_api import expect

from person import (RUN_MS, URL, api, button, confirmed, downloaded, hands, in_dialog, LIMIT_MS, named, pressed, said,
                    state, tabbed, until)
from views import halted, watched, with_status

# A request that fails, and a stop before it is sent again.
STOPPED_ONCE = """import('/web/lib/api.js').then(({ once }) => {
  globalThis.palpateOnce = once('/rig/actions', { action: 'connect', who: 'Ada' }).catch(error => error.message)
  setTimeout(() => document.getElementById('stop').click(), 200)
})"""
RESENT_MS = 1500
# The page is told that the data of the rig are measured.
MEASURED = """import('/web/lib/live.js').then(({ live }) => {
  let kept
  const take = status => { status.rig.label = 'measured'; kept = status }
  take(live.status)
  Object.defineProperty(live, 'status', { get: () => kept, set: take })
})"""

SMALL = """name = 'small'
seed = 5
sensor = 'sensors/ert-28.toml'
[real_hex]
tips = [1]
configurations = 8
depths = 6
block = 8
reference_every = 8
"""


def rig():
    return api("/status")["rig"]


def stored():
    """Number of trials that the active run has stored."""
    return (api("/status")["run"] or {}).get("trials_stored", 0)


def first_evening(page, _browser):
    """From the empty folder by one button to a finished campaign, a trial, a lineage, a dataset."""
    page.goto(URL)
    pressed(page, "Run the quickstart")
    named(page)
    if page.locator("dialog[open]").count():
        in_dialog(page, "Start")
    state(page, "running")
    said(page, re.compile("264"))
    until("the end of the run", lambda: api("/runs")["items"][0].get("exit_status") == "success", 240)
    said(page, "Finished")
    # A trial.
    page.goto(f"{URL}/trials?run=1")
    page.locator("main tbody th a").first.click()
    said(page, re.compile("Twin", re.I))
    expect(page).to_have_url(re.compile("trial="))
    before = page.url

    def another():
        page.keyboard.press("k")
        page.wait_for_timeout(300)
        return page.url != before

    until("the trial before", another)
    # A dataset, its download and its lineage down to a frame.
    api("/datasets", {"name": "run-1"})
    api("/exports", {"dataset": "run-1", "format": "csv"})
    page.goto(f"{URL}/data")
    for table in ("Datasets", "Exports"):
        used = page.get_by_role("region", name=table, exact=True).locator("td[data-head='Last used']").first
        expect(used).to_have_text(re.compile(r"\d\d:\d\d$"), timeout=LIMIT_MS)
    page.locator("main tbody th a").first.click()
    said(page, re.compile("read_parquet"))
    name, content = downloaded(page, lambda: page.get_by_role("link", name="Parquet", exact=True).first.click())
    assert name.endswith(".parquet") and content[:4] == b"PAR1", name
    said(page, "What it was made from")
    page.locator("button.walk-box", has_text="Run 1").first.click()
    page.locator(".walk-list button").first.click()
    expect(page.get_by_role("link", name="Open this trial")).to_be_visible(timeout=LIMIT_MS)
    page.get_by_role("link", name="Open this trial").click()
    expect(page).to_have_url(re.compile("/trials[?]trial="), timeout=LIMIT_MS)
    twins_not_read(page)
    runs_by_conditions(page)
    fit_by_keys(page)
    contacts_by_mouse(page)


def twins_not_read(page):
    """What is not read is not shown as none."""
    page.route("**/api/v1/twins", lambda route: route.abort())
    page.goto(URL)
    twins = page.locator("dl.facts > div").filter(has=page.locator("dt", has_text="Twins")).locator("dd")
    expect(twins).to_have_text("not read yet", timeout=LIMIT_MS)
    page.unroute("**/api/v1/twins")
    expect(twins).to_have_text(re.compile("to do"), timeout=LIMIT_MS)


def runs_by_conditions(page):
    """Runs are selected by the address, in the language of trials; what has no control is a chip that removes it."""
    page.goto(f"{URL}/runs?exit_status=success&experiment=quickstart")
    rows = page.locator("main tbody tr")
    expect(rows).to_have_count(1, timeout=LIMIT_MS)
    expect(page.locator("#state")).to_have_value("exit_status=success")
    pressed(page, "Remove the condition experiment = quickstart")
    expect(page).to_have_url(re.compile("/runs[?]exit_status=success$"), timeout=LIMIT_MS)
    page.locator("#state").select_option("failed")
    expect(page).to_have_url(re.compile("/runs[?]exit_status=fail$"), timeout=LIMIT_MS)
    said(page, "No run is in this selection")
    page.goto(f"{URL}/runs?tips=4")
    said(page, re.compile("there is no column tips; there are scan_id, experiment"))


def contacts_by_mouse(page):
    """A click on the skin presses a contact; one on a contact goes to its load."""
    page.goto(f"{URL}/model?contacts=270,280,20n")
    rows = page.locator(".press-list tbody tr")
    expect(rows).to_have_count(1, timeout=LIMIT_MS)
    skin = page.locator("canvas.skin").first
    box = skin.bounding_box()
    place = {"x": 0.3 * box["width"], "y": 0.3 * box["height"]}
    skin.click(position=place)
    expect(rows).to_have_count(2)
    skin.click(position=place)
    expect(page.get_by_label("Contact 2: load")).to_be_focused()
    expect(rows).to_have_count(2)


def fit_by_keys(page):
    """Box plots are read by keys; a curve that a key hides is hidden by the address, too."""
    page.goto(f"{URL}/model?fit=1")
    boxes = page.locator("canvas.boxes").first
    expect(boxes).to_have_attribute("aria-label", re.compile("median"), timeout=LIMIT_MS)
    at = boxes.locator("xpath=following-sibling::p")
    boxes.focus()
    page.keyboard.press("End")
    expect(at).to_have_text(re.compile("median"))
    assert boxes.get_attribute("aria-label").endswith(at.text_content()), at.text_content()
    page.keyboard.press("Home")
    expect(at).to_have_text(re.compile("^I: median"))
    chart = page.get_by_role("application", name=re.compile("^Mean FVU by largest force"))
    curve = chart.locator(".u-series").nth(1)
    expect(curve).to_be_visible(timeout=LIMIT_MS)
    chart.focus()
    page.keyboard.press("1")
    hidden = re.compile("[?&]hide-mean-fvu=1(&|$)")
    expect(page).to_have_url(hidden)
    page.reload()
    expect(curve).to_have_class(re.compile("u-off"), timeout=LIMIT_MS)
    chart.focus()
    page.keyboard.press("1")
    expect(page).not_to_have_url(hidden)
    expect(curve).not_to_have_class(re.compile("u-off"))


def operate(page, _browser):
    """Checked, armed and started by the page; paused, resumed, stopped at once, homed and finished."""
    errors = watched(page)
    page.goto(f"{URL}/queue")
    said(page, re.compile("quickstart"))
    page.locator("input[type=file]").first.set_input_files(
        {"name": "small.toml", "mimeType": "text/plain", "buffer": SMALL.encode()})
    pressed(page, "Add to queue")
    named(page)
    run = until("the run in the queue", lambda: api("/queue")["items"])[0]
    page.goto(f"{URL}/plan?run={run['scan_id']}")
    said(page, re.compile("48"))
    pressed(page, "Arm and start")
    in_dialog(page, "Start")
    state(page, "running", RUN_MS)
    page.goto(URL)
    pressed(page, "Pause")
    # It measures the surface first: minutes, where other tests share the machine.
    state(page, "paused", RUN_MS)
    resumed_on_a_real_rig(page)
    state(page, "running")
    # Answers that never end hold all connections that a browser opens to one service.
    page.evaluate("import('/web/lib/api.js').then(({ ask }) => { for (let n = 0; n < 8; n += 1)"
                  " ask('/api/v1/events?since=0', { accept: 'text/event-stream', wait: 0 }).catch(() => 0) })")
    page.wait_for_timeout(1000)
    page.get_by_role("button", name="Stop", exact=True).click()
    expect(page.locator("body")).to_contain_text("Emergency stop latched", timeout=2000)
    said(page, re.compile("Every axis acknowledged the stop"))
    pressed(page, "Reset")
    until("the reset", lambda: rig()["state"] != "tripped")
    pressed(page, "Home")
    until("homing", lambda: rig()["state"] == "homed")
    pressed(page, "Resume")
    until("the end of the run", lambda: api(f"/runs/{run['uid']}").get("exit_status") == "success", 240)
    assert not errors, errors


def resumed_on_a_real_rig(page):
    """On a rig that is not virtual the page asks before a paused run moves it. Cancelled, the run stays paused."""
    page.evaluate(MEASURED)
    dialog = page.locator("dialog[open]")
    pressed(page, "Resume")
    expect(dialog).to_contain_text("Keep hands and tools away from the rig", timeout=LIMIT_MS)
    page.keyboard.press("Escape")
    expect(dialog).to_have_count(0)
    page.wait_for_timeout(500)
    assert api("/status")["run"]["state"] == "paused"
    pressed(page, "Resume")
    in_dialog(page, "Resume")
    until("the resumed run", lambda: api("/status")["run"]["state"] != "paused")
    # Virtual again.
    page.goto(URL)


def jog_steps(page):
    """A link cannot choose a larger move than the page offers."""
    page.goto(f"{URL}/rig?step=200&stepz=-0.2")
    step = page.get_by_label("Step of x, y and arms")
    expect(step).to_have_value("0.5")
    expect(page.get_by_label("Step of z")).to_have_value("0.1")
    page.goto(f"{URL}/rig?step=1")
    expect(step).to_have_value("1")
    page.get_by_role("link", name="Rig", exact=True).click()
    expect(step).to_have_value("0.5")


def abort(page, _browser):
    """Abort asks first. Cancelled, the run continues; confirmed, it ends, and what it has stored stays."""
    page.goto(URL)
    run = until("a trial", lambda: stored() > 0 and api("/status")["run"])
    dialog = page.locator("dialog[open]")
    # Neither the key that opened it, held, nor the second click of a double click confirms it.
    button(page, "Abort").focus()
    page.keyboard.down("Enter")
    expect(dialog).to_be_visible()
    page.keyboard.down("Enter")
    page.keyboard.up("Enter")
    dialog.locator("button.main").evaluate("one => one.dispatchEvent(new MouseEvent('click', { detail: 2 }))")
    expect(dialog).to_be_visible()
    page.keyboard.press("Escape")
    expect(dialog).to_have_count(0)
    before = stored()
    until("another trial", lambda: stored() > before)
    pressed(page, "Abort")
    confirmed(page)
    named(page)
    ended = until("the end of the run", lambda: (row := api(f"/runs/{run['uid']}"))["state"] == "ended" and row)
    assert ended["exit_status"] == "abort", ended
    assert api(f"/runs/{run['uid']}/summary")["trials_stored"] > before
    expect(button(page, "Abort")).to_be_hidden(timeout=LIMIT_MS)


def motion(page, _browser):
    """A homing is named on every page, and ends by the button that is there while it moves."""
    page.goto(f"{URL}/rig")
    halt = button(page, "Stop this motion")
    pressed(page, "Connect")
    named(page)
    until("the wires", lambda: rig()["state"] == "disarmed")
    expect(halt).to_be_hidden()
    # It lasts until its limit.
    hands({"cmd": "fault", "kind": "stuck_axis", "device": "x", "for_s": 6000.0})
    pressed(page, "Home")
    expect(halt).to_be_visible(timeout=LIMIT_MS)
    expect(button(page, "Home")).to_be_disabled()
    said(page, "Homing in progress: the axes move.")
    for path in ("/wear", "/", "/rig"):
        page.goto(URL + path)
        state(page, "Rig disarmed, homing")
    # Nobody is asked whether it may stop.
    pressed(page, "Stop this motion")
    said(page, "Stop this motion: accepted.")
    expect(halt).to_be_hidden()
    state(page, re.compile("disarmed$"))
    now = until("the safe end", lambda: (now := rig())["safe_end"] and now)
    assert (now["motion"], now["state"], now["trip"]) == (None, "disarmed", None), now


def keyboard(page, _browser):
    """The stop, the reset and homing without a mouse, and the stop of an open dialog."""
    jog_steps(page)
    page.goto(URL)
    state(page, "running")
    tabbed(page, "#stop", 6)
    page.keyboard.press("Enter")
    expect(page.locator("#stop-said")).to_contain_text(re.compile("latched", re.I), timeout=LIMIT_MS)
    until("the stop", lambda: (rig()["trip"] or {}).get("kind") == "estop")
    until("its acknowledgement", lambda: rig()["estop_acknowledged_ms"] is not None)
    expect(page.locator("#needs button")).to_be_visible(timeout=LIMIT_MS)
    page.wait_for_timeout(500)  # The last words of the stop arrive.
    tabbed(page, "#needs button")
    page.keyboard.press("Enter")
    expect(page.locator("dialog[open]").get_by_label("Name")).to_be_focused(timeout=LIMIT_MS)
    page.keyboard.type("Ada")
    page.keyboard.press("Enter")
    until("the reset", lambda: rig()["state"] == "disarmed")
    expect(button(page, "Home")).to_be_visible(timeout=LIMIT_MS)
    tabbed(page, "#needs button")
    page.keyboard.press("Enter")
    until("homing", lambda: rig()["state"] == "homed")
    # A dialog covers the page, its stop as well: it has another one.
    page.keyboard.press("?")
    expect(page.locator("dialog[open]")).to_be_visible(timeout=LIMIT_MS)
    tabbed(page, "dialog[open] button.stop", 10)
    page.keyboard.press("Space")
    expect(page.locator("dialog[open]")).to_have_count(0)
    until("the second stop", lambda: rig()["state"] == "tripped")
    not_sent_again(page)
    halted_on_every_page(page)


def halted_on_every_page(page):
    """An axis that is not stopped, and a run that does not begin by itself, are named above each page."""
    with_status(halted)(page)
    for path in ("/", "/data", "/settings"):
        page.goto(URL + path)
        needs = page.locator("#needs")
        expect(needs).to_contain_text("NOT STOPPED: y (no reply within 200 ms)", timeout=LIMIT_MS)
        expect(needs).to_contain_text("Run 3 (real-random) does not begin by itself")


def not_sent_again(page):
    """What a person requested before a stop, and what failed, is not sent after it."""
    sent = []

    def fail(route):
        sent.append(route.request.url)
        route.abort()

    page.route("**/api/v1/rig/actions", fail)
    page.evaluate(STOPPED_ONCE)
    assert "the stop ended" in page.evaluate("palpateOnce")
    page.wait_for_timeout(RESENT_MS)
    assert len(sent) == 1, sent
    page.unroute("**/api/v1/rig/actions")
