"""Scenarios of manual trials: the page leads through the placements, and a wrong one is named and repeated."""

import math
import pathlib
import re

from playwright.sync_api import TimeoutError, expect

import views
from person import (LIMIT_MS, RUN_MS, URL, a_viewer, api, asked, button, confirmed, hands, in_dialog, named, pressed,
                    said, seen_as, until)

SENSOR = pathlib.Path(__file__).parents[3] / "experiments/sensors/ert-28.toml"
WEIGHTS = ("name = 'weights'\nseed = 3\nsensor = 's'\n[real_random]\ncontacts = [2]\ntrials_each = 3\n"
           "weights_n = [9.81]\n[measure]\nframes_per_trial = 10\n")
# Longest answer of the service to a key: 8 s for the verdict, and a machine with other work.
KEY_MS = 20_000
# Far from each other and from the rim, mm.
PLACES = [(x, y) for x in (120.0, 270.0, 420.0) for y in (120.0, 280.0, 440.0)]


def place(page, browser):
    """Three trials with weights: the page leads through all, and a viewer only looks on."""
    api("/rig/actions", {"action": "connect", "who": "test"})
    page.goto(f"{URL}/place")
    said(page, "No run waits for weights")
    api("/queue", {"file": "weights.toml", "definition": WEIGHTS, "sensor": SENSOR.read_text(), "who": "test"})
    pressed(page, "Arm and start")
    named(page)
    in_dialog(page, "Start")
    asked(0)
    looks_on(browser)
    for trial in range(3):
        hands({"cmd": "place", "weights": asked(trial)})
        done = button(page, "Done")
        expect(done).to_be_enabled(timeout=LIMIT_MS)
        page.wait_for_timeout(1500)
        page.keyboard.press("Enter")

        def over():
            run = api("/status")["run"]
            return run is None or (run.get("wanted") or {}).get("trial") != trial

        until("the next placement", over)
    until("the end of the run", lambda: api("/runs")["items"][0].get("exit_status") == "success")


def looks_on(browser):
    """A viewer sees the placement, has no button for it, and a key confirms nothing."""
    other = a_viewer(browser)
    other.goto(f"{URL}/place")
    seen_as(other, "viewer")
    expect(other.locator(".weights li")).to_have_count(2, timeout=LIMIT_MS)
    for words in ("Done", re.compile("^Store anyway"), re.compile("^Repeat"), re.compile("^Tare")):
        expect(button(other, words)).to_be_hidden()
    other.keyboard.press("Enter")
    other.wait_for_timeout(500)
    asked(0)
    other.context.close()


def elsewhere(contacts):
    """The same weights, the first one far from where each belongs."""
    far = max(PLACES, key=lambda at: min(math.hypot(at[0] - c["x_mm"], at[1] - c["y_mm"]) for c in contacts))
    return [{**contacts[0], "x_mm": far[0], "y_mm": far[1]}, *contacts[1:]]


def wrong_weight(page, _browser):
    """A weight on a wrong point is reported and not stored; corrected it is stored; then that trial is repeated."""
    views.named(page)
    page.goto(f"{URL}/place")
    contacts = asked(0)
    pressed(page, re.compile("^Tare"))
    until("the tared skin", lambda: api("/placement")["untouched_at"])
    # Named before it is stored.
    hands({"cmd": "place", "weights": elsewhere(contacts)})
    verdict, done = page.locator(".verdict").first, button(page, "Done")
    # The verdict on frames with the weights: before, neither was felt.
    expect(verdict).to_contain_text(re.compile(r"^(?!.*weight 2\b).*weight 1\b", re.I), timeout=RUN_MS)
    expect(verdict).to_have_class(re.compile(r"\bbad\b"))
    expect(done).to_be_enabled(timeout=LIMIT_MS)
    answer = confirmation(page)
    assert answer.status == 409, answer.status
    assert api("/trials")["items"] == []
    # Corrected.
    hands({"cmd": "place", "weights": contacts})
    expect(verdict).to_have_class(re.compile(r"\bgood\b"), timeout=RUN_MS)
    expect(done).to_be_enabled(timeout=LIMIT_MS)
    confirm_right(page)
    asked(1)
    assert [trial["configuration"] for trial in api("/trials")["items"]] == [0]
    # Repeated: withdrawn, asked for again, stored again.
    pressed(page, re.compile("^Repeat"))
    confirmed(page)
    asked(0)
    assert api("/trials")["items"] == []
    # The weights are still on their points: placed again, they would be judged while they swing.
    expect(verdict).to_have_class(re.compile(r"\b(good|warn)\b"), timeout=RUN_MS)
    expect(done).to_be_enabled(timeout=LIMIT_MS)
    confirm_right(page)
    asked(1)
    assert [trial["configuration"] for trial in api("/trials")["items"]] == [0]


def confirm_right(page):
    """Confirms a right placement. In the noise of one window a weight may be felt as two; a person looks again."""
    for _ in range(2):
        if confirmation(page).status == 202:
            return
        expect(button(page, "Done")).to_be_enabled(timeout=LIMIT_MS)
    assert confirmation(page).status == 202


def confirmation(page):
    """Presses the key of the foot switch; returns the answer of the service.

    The page takes no key while the skin moves or its state is old, which may begin after the button was looked at: a
    person presses again, and the key confirms the placement that is shown, no other.
    """
    is_action = lambda answer: answer.request.method == "POST" and answer.url.endswith("/actions")

    def answered():
        try:
            with page.expect_response(is_action, timeout=KEY_MS) as answer:
                page.keyboard.press("PageDown")
            return answer.value
        except TimeoutError:
            return None

    return until("an answer to the key", answered, seconds=240)
