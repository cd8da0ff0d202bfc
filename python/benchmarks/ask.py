"""Ten questions that a lab asks, side by side: Palpate over HTTP, DuckDB, polars, Datasette.

    python benchmarks/ask.py [--url URL] [--runs 1] [--data FOLDER] [--datasette] [--repeat 5] [--json FILE]

DuckDB and polars read the Parquet files of the datasets ``run-1`` to ``run-N`` (--runs), which are fetched
first, or read in the service's folder if --data names it; Palpate reads its own tables over HTTP; Datasette
(with --datasette and --data) reads the service's database. The service must store no other trials. With
several runs the questions 3, 4 and 6, which return or read whole rows, are about run 1.

Each question runs in a separate process: once to warm up, then ``--repeat`` times; once in all if it takes
more than 10 s. Prints for each the median time, the peak memory of the client process, the number of rows,
the characters that the user types, and whether the rows are those of Palpate. ``tests/figures/questions.py``
does all of this at two sizes.
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import json
import math
import resource
import socket
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.parse
import urllib.request
from pathlib import Path
from typing import Any

ENGINES = ("palpate", "duckdb", "polars", "datasette")
MIB = 1024
# A question that takes longer is asked once.
SLOW_MS = 10_000.0


@dataclasses.dataclass(frozen=True)
class Question:
    """A question, and what a user types to get its answer; None: it cannot be asked."""

    words: str
    palpate: str
    duckdb: str
    polars: str
    datasette: str | None
    one_run: bool = False


# FILE stands for the Parquet files. AND_RUN and WHERE_RUN select run 1 if there are several.
QUESTIONS = (
    Question(
        "How many trials have each number of contacts (Table I)?",
        "SELECT contact_count, COUNT(*) AS n FROM trials GROUP BY contact_count ORDER BY contact_count",
        "SELECT contact_count, COUNT(*) AS n FROM 'FILE' GROUP BY contact_count ORDER BY contact_count",
        """pl.scan_parquet("FILE").group_by("contact_count").agg(n=pl.len()).sort("contact_count").collect()""",
        "SELECT contact_count, COUNT(*) AS n FROM trials GROUP BY contact_count ORDER BY contact_count",
    ),
    Question(
        "How does the largest force grow with depth, with one tip (median)?",
        "SELECT depth_mm, MEDIAN(max_force_n) AS force_n, COUNT(max_force_n) AS n FROM trials WHERE tips = 1\n"
        "GROUP BY depth_mm ORDER BY depth_mm",
        "SELECT depth_mm, MEDIAN(max_force_n) AS force_n, COUNT(max_force_n) AS n FROM 'FILE' WHERE tips = 1\n"
        "GROUP BY depth_mm ORDER BY depth_mm",
        """pl.scan_parquet("FILE").filter(pl.col("tips") == 1).group_by("depth_mm").agg(
    force_n=pl.median("max_force_n"), n=pl.count("max_force_n")).sort("depth_mm").collect()""",
        "WITH o AS (SELECT depth_mm, max_force_n,\n"
        "    ROW_NUMBER() OVER (PARTITION BY depth_mm ORDER BY max_force_n) AS k,\n"
        "    COUNT(max_force_n) OVER (PARTITION BY depth_mm) AS n FROM trials WHERE tips = 1)\n"
        "SELECT depth_mm, AVG(max_force_n) AS force_n, MAX(n) AS n FROM o\n"
        "WHERE k IN ((n + 1) / 2, (n + 2) / 2) GROUP BY depth_mm ORDER BY depth_mm",
    ),
    Question(
        "Which trials have 3 contacts or more and more than 10 N? All columns without frames.",
        "SELECT * FROM trials WHERE contact_count >= 3 AND max_force_n > 10 AND_RUN ORDER BY trial_id",
        "SELECT * EXCLUDE (voltages_v, sim_voltages_v) FROM 'FILE'\n"
        "WHERE contact_count >= 3 AND max_force_n > 10 ORDER BY trial_id",
        """pl.scan_parquet("FILE").drop("voltages_v", "sim_voltages_v").filter(
    pl.col("contact_count") >= 3, pl.col("max_force_n") > 10).sort("trial_id").collect()""",
        "SELECT trials.id AS trial_id, * FROM trials JOIN twins ON twins.trial = trials.id\n"
        "WHERE contact_count >= 3 AND max_force_n > 10 AND_RUN ORDER BY trials.id",
        one_run=True,
    ),
    Question(
        "The same trials with both frames.",
        'SELECT * FROM "run-1" WHERE contact_count >= 3 AND max_force_n > 10 ORDER BY trial_id',
        "SELECT * FROM 'FILE' WHERE contact_count >= 3 AND max_force_n > 10 ORDER BY trial_id",
        """pl.scan_parquet("FILE").filter(
    pl.col("contact_count") >= 3, pl.col("max_force_n") > 10).sort("trial_id").collect()""",
        None,
        one_run=True,
    ),
    Question(
        "How is the FVU of the trials with contact distributed (bins of 0.05)?",
        "SELECT FLOOR(fvu * 20) / 20 AS fvu_from, COUNT(*) AS n FROM trials WHERE contact_count > 0\n"
        "GROUP BY fvu_from ORDER BY fvu_from",
        "SELECT FLOOR(fvu * 20) / 20 AS fvu_from, COUNT(*) AS n FROM 'FILE' WHERE contact_count > 0\n"
        "GROUP BY fvu_from ORDER BY fvu_from",
        """pl.scan_parquet("FILE").filter(pl.col("contact_count") > 0).group_by(
    fvu_from=(pl.col("fvu") * 20).floor() / 20).agg(n=pl.len()).sort("fvu_from").collect()""",
        "SELECT CAST(fvu * 20 AS INT) / 20.0 AS fvu_from, COUNT(*) AS n\n"
        "FROM trials JOIN twins ON twins.trial = trials.id WHERE contact_count > 0\n"
        "GROUP BY fvu_from ORDER BY fvu_from",
    ),
    Question(
        "What fraction of the variance does the model leave unexplained, by injection and electrode pair?",
        "SELECT injection, pair, AVG(POWER(voltage_v - sim_voltage_v, 2)) / VARIANCE(voltage_v) AS fvu\n"
        "FROM voltages WHERE_RUN GROUP BY injection, pair ORDER BY injection, pair",
        "SELECT n // 28 AS injection, n % 28 AS pair, AVG((v - s) ** 2) / VAR_SAMP(v) AS fvu\n"
        "FROM (SELECT UNNEST(voltages_v)::DOUBLE AS v, UNNEST(sim_voltages_v)::DOUBLE AS s,\n"
        "      UNNEST(RANGE(784)) AS n FROM 'FILE')\n"
        "GROUP BY ALL ORDER BY ALL",
        """pl.scan_parquet("FILE").select(
    pl.int_ranges(0, 784).alias("n"), v=pl.col("voltages_v").cast(pl.List(pl.Float64)),
    s=pl.col("sim_voltages_v").cast(pl.List(pl.Float64))).explode("n", "v", "s").group_by(
    injection=pl.col("n") // 28, pair=pl.col("n") % 28).agg(
    fvu=((pl.col("v") - pl.col("s")) ** 2).mean() / pl.var("v")).sort("injection", "pair").collect()""",
        None,
        one_run=True,
    ),
    Question(
        "Which ten trials with contact does the model fit worst?",
        "SELECT trial_id, configuration, depth_mm, fvu FROM trials WHERE contact_count > 0\n"
        "ORDER BY fvu DESC, trial_id LIMIT 10",
        "SELECT trial_id, configuration, depth_mm, fvu FROM 'FILE' WHERE contact_count > 0\n"
        "ORDER BY fvu DESC, trial_id LIMIT 10",
        """pl.scan_parquet("FILE").filter(pl.col("contact_count") > 0).select(
    "trial_id", "configuration", "depth_mm", "fvu").sort(
    "fvu", "trial_id", descending=[True, False]).head(10).collect()""",
        "SELECT trials.id AS trial_id, configuration, depth_mm, fvu\n"
        "FROM trials JOIN twins ON twins.trial = trials.id WHERE contact_count > 0\n"
        "ORDER BY fvu DESC, trial_id LIMIT 10",
    ),
    Question(
        "How many contacts, with which mean force, are in each square of 100 mm of the skin?",
        "SELECT FLOOR(x_mm / 100) AS x, FLOOR(y_mm / 100) AS y, COUNT(*) AS n, AVG(force_n) AS force_n\n"
        "FROM contacts GROUP BY x, y ORDER BY x, y",
        "SELECT FLOOR(c.x_mm / 100) AS x, FLOOR(c.y_mm / 100) AS y, COUNT(*) AS n, AVG(c.force_n) AS force_n\n"
        "FROM (SELECT UNNEST(contacts) AS c FROM 'FILE') GROUP BY ALL ORDER BY ALL",
        """pl.scan_parquet("FILE").select("contacts").explode("contacts").drop_nulls().unnest("contacts").group_by(
    x=(pl.col("x_mm") / 100).floor(), y=(pl.col("y_mm") / 100).floor()).agg(
    n=pl.len(), force_n=pl.col("force_n").cast(pl.Float64).mean()).sort("x", "y").collect()""",
        "SELECT CAST(x_mm / 100 AS INT) AS x, CAST(y_mm / 100 AS INT) AS y, COUNT(*) AS n,\n"
        "    AVG(force_n) AS force_n\n"
        "FROM trial_tips JOIN trials ON trials.id = trial_tips.trial JOIN runs ON runs.scan_id = trials.run\n"
        "WHERE force_n >= runs.deadband_n GROUP BY x, y ORDER BY x, y",
    ),
    Question(
        "How well did the rig position and settle, by run and number of tips?",
        "SELECT scan_id, tips, COUNT(*) AS n, AVG(settle_ms) AS settle_ms, MAX(ABS(depth_error_mm)) AS error_mm\n"
        "FROM trials GROUP BY scan_id, tips ORDER BY scan_id, tips",
        "SELECT scan_id, tips, COUNT(*) AS n, AVG(settle_ms) AS settle_ms, MAX(ABS(depth_error_mm)) AS error_mm\n"
        "FROM 'FILE' GROUP BY scan_id, tips ORDER BY scan_id, tips",
        """pl.scan_parquet("FILE").group_by("scan_id", "tips").agg(
    n=pl.len(), settle_ms=pl.mean("settle_ms"), error_mm=pl.col("depth_error_mm").abs().max()).sort(
    "scan_id", "tips").collect()""",
        "SELECT run AS scan_id, tips, COUNT(*) AS n, AVG(settle_ms) AS settle_ms,\n"
        "    MAX(ABS(reached_z_mm - target_z_mm)) AS error_mm\n"
        "FROM trials GROUP BY run, tips ORDER BY run, tips",
    ),
    Question(
        "Which forces have the contacts of the trials that the model fits badly (FVU above 0.2)?",
        "SELECT t.tips, COUNT(*) AS n, AVG(c.force_n) AS force_n, MAX(c.force_n) AS max_force_n\n"
        "FROM contacts c JOIN trials t ON c.trial_id = t.trial_id WHERE t.fvu > 0.2\n"
        "GROUP BY t.tips ORDER BY t.tips",
        "SELECT tips, COUNT(*) AS n, AVG(c.force_n) AS force_n, MAX(c.force_n) AS max_force_n\n"
        "FROM (SELECT tips, UNNEST(contacts) AS c FROM 'FILE' WHERE fvu > 0.2) GROUP BY tips ORDER BY tips",
        """pl.scan_parquet("FILE").filter(pl.col("fvu") > 0.2).select("tips", "contacts").explode(
    "contacts").drop_nulls().unnest("contacts").group_by("tips").agg(
    n=pl.len(), force_n=pl.col("force_n").cast(pl.Float64).mean(),
    max_force_n=pl.max("force_n")).sort("tips").collect()""",
        "SELECT tips, COUNT(*) AS n, AVG(force_n) AS force_n, MAX(force_n) AS max_force_n\n"
        "FROM trial_tips JOIN trials ON trials.id = trial_tips.trial JOIN runs ON runs.scan_id = trials.run\n"
        "JOIN twins ON twins.trial = trials.id WHERE fvu > 0.2 AND force_n >= runs.deadband_n\n"
        "GROUP BY tips ORDER BY tips",
    ),
)


def typed(question: Question, engine: str, file: str, several: bool) -> str | None:
    """What the user types: of several runs a question about one names it."""
    text: str | None = getattr(question, engine)
    run = "trials.run = 1" if engine == "datasette" else "scan_id = 1"
    for word in ("AND", "WHERE"):
        text = text and text.replace(f" {word}_RUN", f" {word} {run}" if several else "")
    return text and text.replace("FILE", file)


def measure(engine: str, text: str, place: str, repeat: int) -> dict[str, Any]:
    """Asks a question in this process: times, memory, rows."""
    ask = asker(engine, place)
    before_mib = peak_mib()
    times_ms: list[float] = []
    table: Any = None
    for n in range(repeat + 1):
        began = time.perf_counter()
        table = ask(text)
        took_ms = 1000 * (time.perf_counter() - began)
        if n or took_ms > SLOW_MS:
            times_ms.append(took_ms)
        if took_ms > SLOW_MS:
            break
    peak = peak_mib()
    rows = table if isinstance(table, list) else table.to_dicts()
    return {
        "ms": statistics.median(times_ms), "peak_mib": peak, "before_mib": before_mib,
        "rows": len(rows), "digest": digest_of(rows),
    }  # fmt: skip


def asker(engine: str, place: str) -> Any:
    """The function that answers a text."""
    if engine == "palpate":
        from palpate import Palpate

        lab = Palpate(place)
        return lab.sql
    if engine == "duckdb":
        import duckdb

        connection = duckdb.connect()
        return lambda text: connection.sql(text).pl()
    if engine == "polars":
        import polars as pl

        return lambda text: eval(text, {"pl": pl})

    def datasette(text: str) -> Any:
        question = urllib.parse.urlencode({"sql": text, "_shape": "objects"})
        with urllib.request.urlopen(f"{place}/palpate.json?{question}") as answer:
            return json.load(answer)["rows"]

    return datasette


def peak_mib() -> float:
    """Largest memory of this process until now."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MIB


def digest_of(rows: list[dict[str, Any]]) -> str:
    """A digest of single values to four digits; of wide rows only their trials."""
    if rows and len(rows[0]) > 8:
        kept = [[row["trial_id"]] for row in rows]
    else:
        kept = [[_rounded(value) for value in row.values()] for row in rows]
    return hashlib.sha256(json.dumps(kept).encode()).hexdigest()[:8]


def _rounded(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value
    return f"{float(value):.4g}" if math.isfinite(value) else str(value)


def datasette_of(database: Path) -> tuple[subprocess.Popen[bytes], str]:
    """Datasette on the database, which it opens read-only; its address."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    process = subprocess.Popen(
        [sys.executable, "-m", "datasette", "serve", str(database), "--port", str(port),
         "--setting", "sql_time_limit_ms", "60000", "--setting", "max_returned_rows", "1000000"],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    url = f"http://127.0.0.1:{port}"
    for _ in range(300):
        try:
            urllib.request.urlopen(f"{url}/-/versions.json").close()
            return process, url
        except OSError:
            if process.poll() is not None:
                break
            time.sleep(0.1)
    process.kill()
    raise SystemExit(f"datasette does not serve {database}: is it installed?")


def files_of(url: str, runs: int, data: Path | None, folder: Path) -> int:
    """Puts the Parquet files of the runs into the folder; returns their rows."""
    from palpate import Palpate

    (folder / "fetched").mkdir()
    rows = 0
    for run in range(1, runs + 1):
        dataset = Palpate(url).dataset(f"run-{run}")
        near = data and (data / "datasets" / f"{dataset.id}.parquet").resolve()
        file = near if near and near.is_file() else dataset.file(folder / "fetched")
        (folder / f"run-{run}.parquet").symlink_to(file)
        rows += len(dataset)
    return rows


def main() -> None:
    """Asks all questions of all engines and prints a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--url", default="http://127.0.0.1:8080")
    parser.add_argument("--runs", type=int, default=1)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--datasette", action="store_true")
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--only", type=int, help="number of one question")
    parser.add_argument("--child", nargs=3, metavar=("ENGINE", "PLACE", "TEXT"))
    args = parser.parse_args()
    if args.child:
        engine, place, text = args.child
        print(json.dumps(measure(engine, text, place, args.repeat)))
        return
    if args.datasette and not args.data:
        parser.error("--datasette needs --data, the folder of the service")
    with tempfile.TemporaryDirectory() as kept:
        folder = Path(kept)
        began = time.perf_counter()
        rows = files_of(args.url, args.runs, args.data, folder)
        print(f"{rows:,} trials of {args.runs} runs, files there after {time.perf_counter() - began:.1f} s\n")
        server, place = datasette_of(args.data / "palpate.db") if args.datasette else (None, "")
        try:
            results = table_of(args, folder, place)
        finally:
            if server:
                server.terminate()
                server.wait()
    if args.json:
        args.json.write_text(json.dumps(results, indent=1) + "\n")


def table_of(args: argparse.Namespace, folder: Path, datasette: str) -> list[dict[str, Any]]:
    """Asks the questions, and prints a line for each."""
    engines = [engine for engine in ENGINES if engine != "datasette" or datasette]
    places = {"palpate": args.url, "datasette": datasette}
    print("| | question | rows |" + "".join(f" {e}: ms | MiB | characters |" for e in engines))
    print("|---" * (3 + 3 * len(engines)) + "|")
    results, several = [], args.runs > 1
    for number, question in enumerate(QUESTIONS, 1):
        if args.only not in (None, number):
            continue
        line, first = "", None
        file = str(folder / ("run-1.parquet" if question.one_run or not several else "run-*.parquet"))
        for engine in engines:
            text = typed(question, engine, file, several)
            found = {"number": number, "question": question.words, "engine": engine}
            if text is None:
                found["error"] = "frames are BLOBs"
            else:
                # The name of the file is as long as the user wants.
                found["characters"] = len(text.replace(file, "run-1.parquet"))
                found |= child(args, engine, places.get(engine, ""), text)
            results.append(found)
            if "error" in found:
                line += f" {found['error']} | | {found.get('characters', '')} |"
                continue
            first = first or found
            differs = "" if found["digest"] == first["digest"] else " (other rows)"
            line += f" {found['ms']:.1f}{differs} | {found['peak_mib']:.0f} | {found['characters']} |"
        print(f"| {number} | {question.words} | {first and first['rows']} |{line}", flush=True)
    return results


def child(args: argparse.Namespace, engine: str, place: str, text: str) -> dict[str, Any]:
    """Asks a question in a separate process."""
    command = [sys.executable, __file__, "--repeat", str(args.repeat), "--child", engine, place, text]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        return {"error": done.stderr.strip().splitlines()[-1][:300]}
    found: dict[str, Any] = json.loads(done.stdout)
    return found


if __name__ == "__main__":
    main()
