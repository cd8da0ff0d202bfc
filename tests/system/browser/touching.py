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
    expect(fact(page, "Contacts")).to_have_text(re.compile(r"^[0-6]$"))
    expect(fact(page, "Sum of forces")).to_have_text(re.compile(r"\d\sN$"))
    expect(fact(page, "Position")).to_have_text(re.compile(r"\d\smm$"))
    record(page)
    assert not errors, errors


def fact(page, name):
    """The value of a fact by its name."""
    return page.locator("dt", has_text=re.compile(f"^{name}$")).locator("xpath=following-sibling::dd[1]")


def record(page):
    """Frames that are recorded are there after a reload, and in the file."""
    pressed(page, re.compile("^Record$"))
    page.wait_for_timeout(RECORDED_MS)
    pressed(page, "Stop recording")
    kept = page.get_by_text(re.compile(r"frames are kept"))
    expect(kept).to_be_visible()
    page.reload()
    expect(kept).to_be_visible()
    number = int(kept.inner_text().split(" of ")[0].replace(",", ""))
    name, text = downloaded(page, lambda: pressed(page, "Download NDJSON"))
    frames = [json.loads(line) for line in text.splitlines()]
    assert "virtual" in name and len(frames) == number > 0, (name, len(frames), number)
    assert len(frames[0]["voltages_v"]) == 784
    expect(page.get_by_text("saved")).to_be_visible()
