"""The rows that there should be, worked out from the database."""

import json
import sqlite3
from collections import defaultdict

import numpy as np
import pyarrow.parquet as pq

from wire import DATABASE, check
from columns import COLUMNS, milliseconds, plain, single

DEADBAND_N = 5.0


def stored_trials(database: sqlite3.Connection) -> list[dict]:
    """Every trial with all columns, contacts by its run's deadband."""
    children = defaultdict(lambda: {"tips": [], "placed": []})
    for tip in database.execute("SELECT * FROM trial_tips ORDER BY trial, arm"):
        children[tip["trial"]]["tips"].append(tip)
    for placed in database.execute("SELECT * FROM placed_contacts ORDER BY trial, n"):
        children[placed["trial"]]["placed"].append(placed)
    trials = database.execute(
        """SELECT t.*, r.uid, r.experiment, r.kind, r.label, r.deadband_n, r.tip_diameter_mm, r.state,
               v.voltages_v, w.rmse_v, w.fvu, m.hash AS sim_model, s.voltages_v AS sim_voltages_v
           FROM trials t JOIN runs r ON r.scan_id = t.run JOIN trial_voltages v ON v.trial = t.id
           LEFT JOIN twins w ON w.trial = t.id
               AND w.model = (SELECT max(model) FROM twins x WHERE x.trial = t.id)
           LEFT JOIN twin_models m ON m.id = w.model
           LEFT JOIN twin_voltages s ON s.trial = t.id AND s.model = w.model ORDER BY t.id"""
    )
    return [trial(row, **children[row["id"]]) for row in trials]


def trial(row: sqlite3.Row, tips: list, placed: list) -> dict:
    found = {name: row[name] for name in COLUMNS if name in row.keys()}
    forces = {tip["arm"]: single(tip["force_n"]) for tip in tips}
    volts = lambda blob: None if blob is None else np.frombuffer(blob, "<f4")
    found |= {
        "trial_id": row["id"], "run": row["uid"], "scan_id": row["run"], "seed": None, "index": None,
        "contacts": labelled(row, tips, placed, row["deadband_n"]),
        "max_force_n": single(row["max_force_n"]), "flags": tuple(json.loads(row["flags"])),
        "forces_n": tuple(forces.get(arm) for arm in range(1, 7)) if forces else None,
        "voltages_v": volts(row["voltages_v"]), "sim_voltages_v": volts(row["sim_voltages_v"]),
        "depth_error_mm": None, "split": None, "kind": row["kind"], "state": row["state"],
        "places": tuple(sorted((round(t["x_mm"], 3), round(t["y_mm"], 3)) for t in tips)),
        "by_deadband": lambda deadband_n: labelled(row, tips, placed, deadband_n),
    }
    if row["reached_z_mm"] is not None and row["target_z_mm"] is not None:
        found["depth_error_mm"] = row["reached_z_mm"] - row["target_z_mm"]
    for time in ["started_at", "measured_at"]:
        found[time] = None if row[time] is None else milliseconds(row[time])
    counted = (found["contact_count"], len(found["contacts"]))
    check(counted[0] == counted[1], f"database, trial {row['id']}: contact_count and contacts are {counted}")
    return found


def labelled(row: sqlite3.Row, tips: list, placed: list, deadband_n: float) -> tuple:
    if row["kind"] == "real-hex":
        rows = [tip for tip in tips if tip["force_n"] >= deadband_n]
        return tuple((t["x_mm"], t["y_mm"], single(t["force_n"]), single(row["tip_diameter_mm"])) for t in rows)
    wide = lambda p: p["diameter_mm"] if p["diameter_mm"] is not None else row["tip_diameter_mm"]
    return tuple((p["x_mm"], p["y_mm"], single(p["force_n"]), single(wide(p))) for p in placed)


def real_hex(trials: list[dict]) -> list[dict]:
    """Trials of ended Real-Hex runs without a flag, labelled with 5 N."""
    rows = []
    for row in trials:
        if row["kind"] == "real-hex" and row["state"] == "ended" and not row["flags"]:
            contacts = row["by_deadband"](DEADBAND_N)
            rows.append({**row, "contacts": contacts, "contact_count": len(contacts)})
    return rows


def sim_random() -> list[dict]:
    """The rows of the shards next to the database."""
    rows = []
    for manifest in sorted(DATABASE.parent.glob("sim-random/*/_manifest.json")):
        for shard in json.loads(manifest.read_text())["shards"]:
            table = pq.read_table(manifest.parent / shard["file"])
            for row in table.to_pylist():
                row = {name: plain(name, row.get(name)) for name in COLUMNS}
                rows.append({**row, "label": "simulated", "places": None, "kind": "sim-random"})
    return rows


def expected_rows(trials: list[dict]) -> dict[str, list[dict]]:
    real = real_hex(trials)
    newest = {row["sim_model"] for row in real} - {None}
    twins = [row for row in real if row["contacts"] and row["sim_voltages_v"] is not None]
    if len(newest) > 1:
        raise SystemExit(f"twins of several models ({newest}): this check knows one")
    return {
        "run-1": [row for row in trials if row["scan_id"] == 1],
        "real": [row for row in real if row["contacts"]],
        "real-untouched": [row for row in real if not row["contacts"]],
        "r2s-transfer": twins,
        "s2s-recon": [*twins, *sim_random()],
    }
