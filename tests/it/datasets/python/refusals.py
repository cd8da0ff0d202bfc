"""Queries and requests that must be refused, and in which words."""

from wire import check, get

BAD = [  # Address, status, words that the body must have.
    ("/api/v1/datasets/real/rows?colour=red", 400, ["colour", "contact_count"]),
    ("/api/v1/datasets/real/rows?columns=colour", 400, ["colour", "contact_count"]),
    ("/api/v1/datasets/real/rows?columns=seed", 400, ["seed", "contact_count"]),
    ("/api/v1/datasets/real/rows?rmse_v__gt=1", 400, ["rmse_v", "contact_count"]),
    ("/api/v1/datasets/real/rows?contact_count__gt=many", 400, ["contact_count", "many", "number"]),
    ("/api/v1/datasets/real/rows?contact_count__near=3", 400, ["near", "gte"]),
    ("/api/v1/datasets/real/rows?voltages_v__gt=1", 400, ["voltages_v", "contact_count"]),
    ("/api/v1/datasets/real/rows?contacts=1", 400, ["contacts", "contact_count"]),
    ("/api/v1/datasets/real/rows?started_at__gt=yesterday", 400, ["started_at", "3339"]),
    ("/api/v1/datasets/real/rows?split__gt=train", 400, ["split", "eq"]),
    ("/api/v1/datasets/real/rows?map=3x20", 400, ["map", "640"]),
    ("/api/v1/datasets/real/rows?map=1x20", 400, ["map", "160"]),
    ("/api/v1/datasets/real/rows?map=4x0", 400, ["map", "diameter"]),
    ("/api/v1/datasets/real/rows?map=4x1000", 400, ["map", "320"]),
    ("/api/v1/datasets/real/rows?map=nanxnan", 400, ["map"]),
    ("/api/v1/datasets/real/rows?map=fine", 400, ["map", "4x20"]),
    ("/api/v1/datasets/real/rows?limit=1000000", 400, ["limit", "10000", "export"]),
    ("/api/v1/datasets/real/rows?limit=0", 400, ["limit"]),
    ("/api/v1/datasets/real/rows?limit=-1", 400, ["limit"]),
    ("/api/v1/datasets/real/rows?cursor=first", 400, ["cursor"]),
    ("/api/v1/datasets/real/rows?format=xlsx", 400, ["format", "parquet", "json"]),
    ("/api/v1/datasets/real/rows?format=npz", 400, ["format", "parquet"]),
    ("/api/v1/datasets/real/rows?slice=700:785", 400, ["slice", "784"]),
    ("/api/v1/datasets/real/rows?slice=5:5", 400, ["slice", "784"]),
    ("/api/v1/datasets/real/rows?slice=28", 400, ["slice", "784"]),
    ("/api/v1/data/real.parquet?columns=colour", 400, ["colour", "contact_count"]),
    ("/api/v1/data/real.csv?map=3x20", 400, ["map", "640"]),
    ("/api/v1/data/real.parquet?tips__gt=many", 400, ["tips", "many"]),
    ("/api/v1/data/real.parquet?limit=10", 400, ["limit"]),
    ("/api/v1/data/real.parquet?cursor=10", 400, ["cursor"]),
    ("/api/v1/data/real.parquet?format=csv", 400, ["format"]),
    ("/api/v1/data/real.xlsx", 404, ["xlsx", "parquet"]),
    ("/api/v1/data/real", 404, ["parquet"]),
    ("/api/v1/data/nothing.parquet", 404, ["nothing", "r2s-transfer"]),
    ("/api/v1/data/ds-0000000000000000.parquet", 404, ["ds-0000000000000000"]),
    ("/api/v1/data/run-99.parquet", 404, ["run-99"]),
    ("/api/v1/datasets/nothing", 404, ["nothing", "r2s-transfer"]),
    ("/api/v1/datasets/nothing/rows", 404, ["nothing"]),
    ("/api/v1/datasets/..%2f..%2fpalpate/rows", 404, []),
    ("/api/v1/data/..%2f..%2fpalpate.parquet", 404, []),
    ("/api/v1/trials?colour=red", 400, ["colour", "contact_count"]),
    ("/api/v1/trials?columns=colour", 400, ["colour", "contact_count"]),
    ("/api/v1/trials?columns=split&format=arrow", 400, ["split", "contact_count"]),
    ("/api/v1/trials?tips=many", 400, ["tips", "many", "number"]),
    ("/api/v1/trials?max_force_n__gt=nan", 400, ["max_force_n", "nan"]),
    ("/api/v1/trials?columns=trial_id", 400, ["columns", "format=ndjson"]),
    ("/api/v1/trials?voltages_v__gt=1", 400, ["voltages_v", "contact_count"]),
    ("/api/v1/trials?limit=1000000", 400, ["limit", "10000"]),
    ("/api/v1/trials?format=xlsx", 400, ["format", "parquet", "json"]),
    ("/api/v1/trials?format=npz", 400, ["format", "parquet"]),
    ("/api/v1/trials?slice=0:785&voltages=true&format=arrow", 400, ["slice", "784"]),
    ("/api/v1/trials?slice=0:28&voltages=true", 400, ["slice", "format=ndjson"]),
    ("/api/v1/trials?voltages=perhaps", 400, ["voltages", "true"]),
    ("/api/v1/trials?cursor=x", 400, ["cursor"]),
    ("/api/v1/trials?sort=colour", 400, ["sort", "-COLUMN", "trial_id"]),
    ("/api/v1/trials?flag=colour", 400, ["flag", "unsettled"]),
    ("/api/v1/runs/99/trials?format=csv", 404, ["99"]),
]
BAD_EXPORTS = [
    ({"dataset": "real", "format": "xlsx"}, {400, 422}, ["xlsx", "parquet"]),
    ({"dataset": "nothing", "format": "csv"}, {404}, ["nothing"]),
    ({"dataset": "real", "format": "csv", "map": "3x20"}, {400}, ["map", "640"]),
    ({"dataset": "real", "format": "csv", "columns": ["colour"]}, {400}, ["colour", "contact_count"]),
    ({"dataset": "real", "format": "csv", "where": ["colour=red"]}, {400}, ["colour", "contact_count"]),
    ({"dataset": "real", "format": "csv", "colour": 1}, {400, 422}, ["colour"]),
]


def check_refusals() -> None:
    asked = [(f"GET {path}", get(path), {status}, words) for path, status, words in BAD]
    posted = lambda body: get("/api/v1/exports", "POST", body)
    asked += [(f"POST /api/v1/exports {body}", posted(body), status, words) for body, status, words in BAD_EXPORTS]
    for what, (status, headers, body), allowed, words in asked:
        text = body[:2000].decode(errors="replace")
        if not check(status in allowed, f"{what}: {status}, not {allowed}: {text[:200]}"):
            continue
        kind = headers["Content-Type"]
        check(kind == "application/problem+json", f"{what}: Content-Type {kind}")
        lacking = [word for word in words if word not in text]
        check(not lacking, f"{what}: the body does not say {lacking}: {text[:300]}")
