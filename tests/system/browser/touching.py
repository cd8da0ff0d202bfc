"""Scenario of nets: one is promoted by the page, and what touches the skin is followed live."""

import re

from person import URL, api, hands, in_dialog, named, pressed, said, until
from views import watched


def touch(page, _browser):
    """A trained net is promoted by the page, and what it detects is followed live."""
    errors = watched(page)
    page.goto(f"{URL}/nets")
    pressed(page, re.compile("^Promote"))
    in_dialog(page, "Promote")
    named(page)
    until("the promotion", lambda: any(one.get("what") for one in api("/serving")["serves"]))
    hands({"cmd": "place", "weights": [{"x_mm": 270.0, "y_mm": 280.0, "force_n": 9.81}]})
    page.goto(f"{URL}/live?method=fast")
    said(page, re.compile("per s|/s|frames"))
    page.wait_for_timeout(3000)
    assert not errors, errors
