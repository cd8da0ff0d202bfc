"""Every question of ``Palpate``, asked of a real service."""

from __future__ import annotations

import json
import os
import urllib.error
import urllib.request
from collections import Counter
from datetime import datetime, timezone
from typing import Any
from urllib.parse import urlencode

import pandas as pd
import polars as pl
import pyarrow as pa
import pytest
from conftest import Service

import palpate._client
from palpate import Palpate, PalpateError

TRIALS = 264 + 2


def raw(service: Service, path: str) -> Any:
    """What the service answers without this package."""
    with urllib.request.urlopen(service.url + path) as answer:
        return json.load(answer)


def test_sql_counts_what_the_service_counts(lab: Palpate[pl.DataFrame], service: Service) -> None:
    counted = lab.sql(
        "SELECT contact_count, COUNT(*) AS n FROM trials GROUP BY contact_count ORDER BY contact_count"
    )
    items = raw(service, "/api/v1/trials?limit=10000")["items"]
    assert dict(counted.iter_rows()) == Counter(item["contact_count"] for item in items)
    assert counted["n"].sum() == TRIALS


def test_every_library_gets_its_own_tables(lab: Palpate[pl.DataFrame]) -> None:
    statement = 'SELECT trial_id, voltages_v FROM "run-1" ORDER BY trial_id LIMIT 3'
    frames = lab.sql(statement)
    assert isinstance(frames, pl.DataFrame) and frames["voltages_v"].list.len().to_list() == [784] * 3
    tables = lab.pandas()
    frame = tables.sql(statement)
    assert isinstance(frame, pd.DataFrame) and frame.voltages_v[0].tolist() == frames["voltages_v"][0].to_list()
    assert isinstance(lab.arrow().sql(statement), pa.Table)
    assert isinstance(tables.polars().sql(statement), pl.DataFrame)


def test_tables_are_those_that_sql_reads(lab: Palpate[pl.DataFrame]) -> None:
    names = lab.tables()["name"].to_list()
    assert {"trials", "contacts", "frames", "twins", "voltages", "real", "run-1"} <= set(names)
    for name in ("trials", "contacts", "frames", "real"):
        assert lab.sql(f'SELECT * FROM "{name}" LIMIT 1').height == 1


def test_trials_of_a_run_that_meet_conditions(lab: Palpate[pl.DataFrame], service: Service) -> None:
    found = lab.trials(run=1, tips=4, max_force_n__gt=10, columns=["trial_id", "tips", "max_force_n"])
    items = raw(service, "/api/v1/runs/1/trials?limit=10000")["items"]
    wanted = [item["trial_id"] for item in items if item["tips"] == 4 and item["max_force_n"] > 10]
    assert found.columns == ["trial_id", "tips", "max_force_n"]
    assert found["trial_id"].to_list() == wanted and len(wanted) > 10


def test_several_values_times_and_flags_are_conditions(lab: Palpate[pl.DataFrame]) -> None:
    tips = lab.trials(tips=[1, 4], columns="tips")["tips"]
    assert set(tips) == {1, 4} and len(tips) == 264 + len(lab.trials(run=2, tips=1))
    assert lab.trials(tips__in=(4, 9), columns=["tips"])["tips"].unique().to_list() == [4]
    middle = lab.trials(run=1)["measured_at"].median()
    assert isinstance(middle, datetime)
    after = lab.trials(run=1, measured_at__gt=middle, columns=["measured_at"])
    assert 100 < len(after) <= 132 and after["measured_at"].min() > middle  # type: ignore[operator]
    flagged, good = lab.trials(flagged=True), lab.trials(flagged=False)
    assert len(flagged) + len(good) == TRIALS
    assert len(lab.trials(flag="silent_skin")) <= len(flagged)


def test_pages_are_followed_to_the_end(
    lab: Palpate[pl.DataFrame], monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = lab.trials(columns=["trial_id"])
    monkeypatch.setattr(palpate._client, "PAGE_ROWS", 100)
    monkeypatch.setattr(palpate._client, "ITEMS", 10)
    assert lab.trials(columns=["trial_id"]).equals(whole) and len(whole) == TRIALS
    assert lab.trials(limit=150).height == 150
    assert lab.trials(limit=7).height == 7
    newest = lab.trials(columns=["trial_id"], newest_first=True, limit=120)["trial_id"].to_list()
    assert newest == whole["trial_id"].to_list()[::-1][:120]
    assert len(lab.pandas().trials(limit=150)) == 150 and lab.arrow().trials(limit=150).num_rows == 150
    seqs = lab.events()["seq"].to_list()
    assert len(seqs) > 20 and seqs == sorted(set(seqs))


def test_skins_of_different_channels_fit_into_one_table(
    lab: Palpate[pl.DataFrame], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(palpate._client, "PAGE_ROWS", 1)
    lengths = [784, 208, 208]
    first = lab.trials(run=1, limit=1)["trial_id"][0]
    conditions: dict[str, Any] = {"trial_id": [first, *lab.trials(run=2)["trial_id"]]}
    both = lab.trials(voltages=True, columns=["voltages_v"], **conditions)
    assert both["voltages_v"].list.len().to_list() == lengths
    table = lab.pandas().trials(voltages=True, columns=["voltages_v"], **conditions)
    assert [len(frame) for frame in table.voltages_v] == lengths


def test_frames_come_when_they_are_asked_for(lab: Palpate[pl.DataFrame]) -> None:
    assert "voltages_v" not in lab.trials(run=1, limit=1).columns
    frame = lab.trials(run=1, limit=1, voltages=True)
    assert frame.schema["voltages_v"] == pl.Array(pl.Float32, 784)
    some = lab.trials(run=1, limit=1, columns=["voltages_v"], slice="28:56")
    assert some["voltages_v"][0].to_list() == frame["voltages_v"][0].to_list()[28:56]


def test_runs_events_and_datasets_are_tables(lab: Palpate[pl.DataFrame], service: Service) -> None:
    runs = lab.runs()
    assert runs["experiment"].to_list() == ["pad-study", "quickstart"]
    assert runs.schema["started_at"] == pl.Datetime("ms", "UTC")
    run = raw(service, "/api/v1/runs/1")
    assert runs.filter(scan_id=1)["is_resumable"].to_list() == [run["is_resumable"]]
    ended = runs.filter(scan_id=1)["ended_at"][0]
    shown = run["ended_at"].removesuffix("Z").split(".")[0]
    assert ended.replace(microsecond=0) == datetime.fromisoformat(shown).replace(tzinfo=timezone.utc)
    assert lab.run(1)["uid"] == runs.filter(scan_id=1)["uid"][0] == run["uid"]
    events = lab.events(run=1, kind=["state", "ended"])
    assert set(events["kind"]) == {"state", "ended"} and json.loads(events["data"][-1])
    end = lab.events(run=1, kind="ended")
    assert set(end["seq"]) < set(events["seq"]) and set(end["importance"]) == {"notable"}
    assert end["words"][-1].startswith("run ended, ")
    last = events["seq"][-1]
    assert lab.events(run=1, since=last - 1)["seq"][0] == last
    none = lab.events(kind="no-such-kind")
    assert none.is_empty() and none.schema == events.schema
    assert {"real", "r2s-transfer", "run-1"} <= set(lab.datasets()["name"])
    table = lab.pandas().runs()
    assert list(table.experiment) == ["pad-study", "quickstart"]
    assert lab.arrow().events(kind="no-such-kind").num_rows == 0


def test_any_other_path_is_json(lab: Palpate[pl.DataFrame]) -> None:
    assert lab.get("/runs/1/summary")["trials_stored"] == 264
    assert len(lab.get("/actions", limit=1)["items"]) == 1


def test_a_refused_question_reaches_the_user_with_the_words_of_the_service(
    lab: Palpate[pl.DataFrame], service: Service
) -> None:
    with pytest.raises(PalpateError, match="no column force in trials") as refused:
        lab.sql("SELECT force FROM trials")
    assert refused.value.status == 400 and refused.value.title == "Bad Request"
    assert refused.value.errors[0]["key"] == "sql" and "max_force_n" in refused.value.detail
    with pytest.raises(PalpateError, match="nothing can be written"):
        lab.sql("DELETE FROM trials")
    with pytest.raises(PalpateError, match="there is no column force; there are trial_id") as unknown:
        lab.trials(force__gt=3)
    assert unknown.value.errors[0]["key"] == "force__gt"
    with pytest.raises(PalpateError, match=r"no run 999 \(HTTP 404\)"):
        lab.run(999)


def test_a_refused_question_reaches_readers_of_an_address_with_its_words(service: Service) -> None:
    question = urlencode({"sql": "SELECT force FROM trials", "format": "parquet"})
    with pytest.raises(urllib.error.HTTPError, match="HTTP Error 400: .*no column force in trials") as refused:
        pd.read_parquet(f"{service.url}/api/v1/query?{question}")
    refused.value.close()
    with pytest.raises(urllib.error.HTTPError, match="HTTP Error 400: .*there is no column force") as refused:
        pd.read_csv(f"{service.url}/api/v1/trials?format=csv&force__gt=3")
    refused.value.close()


def test_environment_names_service_and_key(
    service: Service, guarded: Service, monkeypatch: pytest.MonkeyPatch, tmp_path: Any
) -> None:
    monkeypatch.setenv("PALPATE_URL", service.url + "/")
    assert repr(Palpate()) == f"Palpate('{service.url}')" and len(Palpate().runs()) == 2
    monkeypatch.setenv("PALPATE_URL", guarded.url)
    monkeypatch.setenv("PALPATE_CA", str(guarded.data / "cert.pem"))
    with pytest.raises(PalpateError) as refused:
        Palpate().runs()
    assert refused.value.status == 401
    assert guarded.key is not None
    (tmp_path / "key").write_text(guarded.key + "\n")
    monkeypatch.setenv("PALPATE_KEY_FILE", str(tmp_path / "key"))
    assert len(Palpate().runs()) == 2
    monkeypatch.setenv("PALPATE_KEY", "palpate_" + 64 * "0")
    with pytest.raises(PalpateError) as refused:
        Palpate().runs()
    assert refused.value.status == 401
    assert len(Palpate(key=guarded.key).runs()) == 2
    assert os.environ["PALPATE_KEY"] != guarded.key


@pytest.mark.parametrize("url", ["127.0.0.1:8080", "ftp://127.0.0.1", "http://"])
def test_an_address_that_is_none_is_refused(url: str) -> None:
    with pytest.raises(ValueError, match="must be http"):
        Palpate(url)
