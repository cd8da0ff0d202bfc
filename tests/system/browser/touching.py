"""Scenario of nets: one is promoted by the page, contacts and quantities are followed live, and frames are recorded."""

import json
import re

from playwright.sync_api import expect

from person import URL, api, downloaded, hands, in_dialog, named, pressed, until
from views import watched

RECORDED_MS = 2000


def touch(page, _browser):
    """A trained net is promoted by the page, and what it detects is followed live."""
    errors = watched(page)
    page.goto(f"{URL}/nets")
    pressed(page, re.compile("^Promote"))
    in_dialog(page, "Promote")
    named(page)
    until("the promotion", lambda: any(one["slot"] == "points" and one.get("what") for one in api("/serving")["serves"]))
    hands({"cmd": "place", "weights": [{"x_mm": 270.0, "y_mm": 280.0, "force_n": 9.81}]})
    page.goto(f"{URL}/live?method=fast")
    # Answers come and are drawn; a net that was trained for seconds may detect nothing.
    for name in ("Answers", "Drawn"):
        expect(fact(page, name)).to_have_text(re.compile(r"^[1-9]\d* per s"))
    # Two readings are a second apart.
    expect(fact(page, "Missing, last minute")).to_have_text(re.compile(r"^(none|[\d,]+ of [\d,]+ frames)"))
    expect(fact(page, "Contacts")).to_have_text(re.compile(r"^[0-6]$"))
    expect(fact(page, "Sum of forces")).to_have_text(re.compile(r"\d\sN$"))
    expect(fact(page, "Position")).to_have_text(re.compile(r"\d\smm$"))
    record(page)
    assert not errors, errors


def fact(page, name):
    """The value of a fact by its name."""
    return page.locator("dt", has_text=re.compile(f"^{name}$")).locator("xpath=following-sibling::dd[1]")


def record(page):
    """Frames that are recorded are in the file, with their label; a stop keeps the whole rows of a text."""
    page.get_by_label("Format of the file").select_option("ndjson")
    pressed(page, re.compile("^Record$"))
    page.wait_for_timeout(RECORDED_MS)
    name, text = downloaded(page, lambda: pressed(page, "Stop and save"))
    frames = [json.loads(line) for line in text.splitlines()]
    assert "virtual" in name and name.endswith(".ndjson") and frames, name
    assert all(len(frame["voltages_v"]) == 784 and frame["label"] == "virtual" for frame in frames)
    sequences = [frame["sequence"] for frame in frames]
    assert sequences == sorted(set(sequences)), sequences
    expect(page.get_by_text(re.compile(f"^Frames saved: {len(frames)} of 300"))).to_be_visible()
    expect(page.get_by_role("button", name="Record", exact=True)).to_be_focused()
