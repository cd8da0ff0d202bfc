"""What the package names is what the service describes: it stays current without generated code."""

from __future__ import annotations

import doctest
import importlib
import json
import pkgutil
import re
import sys
import urllib.request
from typing import Any
from urllib.parse import parse_qsl, urlsplit

import pytest
from conftest import Service

import palpate._dataset
import palpate._http
from palpate import Palpate
from palpate._frames import DATASETS, EVENTS, RUNS, TABLES, needed

SINGLE = re.compile(r"__(eq|gt|gte|lt|lte|in)$")


@pytest.fixture(scope="module")
def described(service: Service) -> Any:
    with urllib.request.urlopen(f"{service.url}/openapi.json") as answer:
        return json.load(answer)


def test_every_request_is_one_that_the_service_describes(
    service: Service, described: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Any
) -> None:
    sent: list[tuple[str, str]] = []
    ask = palpate._http.Service.ask

    def noted(self: Any, method: str, target: str, *more: Any) -> Any:
        sent.append((method.lower(), target))
        return ask(self, method, target, *more)

    monkeypatch.setattr(palpate._http.Service, "ask", noted)
    lab = Palpate(service.url)
    lab.sql("SELECT 1 AS one FROM trials LIMIT 1")
    lab.tables()
    lab.trials(run=1, columns=["trial_id"], flag="unsettled", flagged=True, newest_first=True, tips__gte=1)
    lab.trials(voltages=True, slice="0:28", limit=3)
    lab.runs()
    lab.run(1)
    lab.events(run=1, kind="trip", since=0)
    lab.datasets()
    real = lab.dataset("real")
    real.polars()
    real.pandas(columns=["trial_id"], map="20x60", slice="0:28", split="train")
    real.card()
    real.file(tmp_path)
    real._rows_file(("voltages_v", "force_map_n"), "20x60", tmp_path, {"split": "train"})
    assert len({urlsplit(target).path for _, target in sent}) == 12
    for method, target in sent:
        parts = urlsplit(target)
        operation = operation_of(described, method, parts.path)
        names = {parameter["name"] for parameter in operation.get("parameters", [])}
        columns: list[str] = next((p["schema"]["items"]["enum"] for p in operation.get("parameters", [])
                        if p["name"] == "columns"), [])  # fmt: skip
        for name, _ in parse_qsl(parts.query):
            assert name in names or SINGLE.sub("", name) in columns, (target, name)


def operation_of(described: Any, method: str, path: str) -> Any:
    """The description of a request."""
    for template, item in described["paths"].items():
        pattern = re.sub(r"\{[^}]*\}", "[^/]+", template)
        if re.fullmatch(pattern, path) and method in item:
            return item[method]
    raise AssertionError(f"{method} {path} is not described")


@pytest.mark.parametrize(
    ("schema", "columns"),
    [("RunRow", RUNS), ("Event", EVENTS), ("DatasetOut", DATASETS), ("QueryTable", TABLES)],
)
def test_every_column_of_a_list_is_one_that_the_service_describes(
    described: Any, schema: str, columns: dict[str, type]
) -> None:
    assert set(columns) <= set(described["components"]["schemas"][schema]["properties"])


def test_the_examples_in_the_source_are_right() -> None:
    tried = 0
    for module in pkgutil.iter_modules(palpate.__path__, "palpate."):
        if module.name != "palpate._torch":
            failed, count = doctest.testmod(importlib.import_module(module.name))
            assert not failed, module.name
            tried += count
    assert tried >= 8


def test_a_missing_library_is_named_with_its_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "no_such_module", None)
    with pytest.raises(ImportError, match="this needs no_such_module: pip install no_such_module"):
        needed("no_such_module")


def test_the_package_needs_no_library() -> None:
    import subprocess

    script = "import sys, palpate; print(sorted({'polars', 'pandas', 'pyarrow', 'numpy', 'torch'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
