"""Reads a folder of Sim-Random shards as a notebook does, and answers one line of JSON.

Uses: pandas, pyarrow. Never: anything of palpate but the files. Usage: read.py FOLDER ROW..
"""

import json
import sys
from pathlib import Path

import pandas as pd
import pyarrow.parquet as pq

folder, rows = sys.argv[1], [int(row) for row in sys.argv[2:]]
frame = pd.read_parquet(folder).sort_values("index", ignore_index=True)
table = pq.read_table(folder)
shard = pq.ParquetFile(next(Path(folder).glob("*.parquet")))
contact = table.schema.field("contacts").type.value_type
voltage = table.schema.field("sim_voltages_v").type.value_field


def unit(field):
    return (field.metadata or {}).get(b"unit", b"").decode()


def columns(fields):
    return {f.name: [str(f.type), f.nullable, unit(f)] for f in fields}


print(json.dumps({
    "rows": len(frame),
    "index": [int(frame["index"].iloc[0]), int(frame["index"].iloc[-1])],
    "distinct": int(frame["index"].nunique()),
    "nulls": int(frame.isna().sum().sum()),
    "counts_agree": bool((frame["contacts"].map(len) == frame["contact_count"]).all()),
    "forces_agree": bool((frame["contacts"].map(lambda c: max(x["force_n"] for x in c))
                          == frame["max_force_n"]).all()),
    "columns": columns(table.schema),
    "contact": columns([contact.field(i) for i in range(contact.num_fields)]),
    "voltage": [str(voltage.type), voltage.nullable, unit(voltage)],
    "definition": json.loads(shard.metadata.metadata[b"palpate.definition"]),
    "trials": [{
        "index": row,
        "contacts": [{k: float(v) for k, v in c.items()} for c in frame["contacts"][row]],
        "voltages_v": [float(v) for v in frame["sim_voltages_v"][row]],
    } for row in rows],
}))
