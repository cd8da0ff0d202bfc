-- Trained models, the long computations that made and judged them, and which of them serve.
-- Files hold what models and calibrations are; here is what is known of them.

CREATE TABLE models (
    id         TEXT PRIMARY KEY,              -- `mdl-` and the start of a sha256 over its contents
    name       TEXT NOT NULL,
    task       TEXT NOT NULL,                 -- transfer, recon, end-to-end, points
    manifest   TEXT NOT NULL,                 -- TOML, as in its folder
    created_at TEXT NOT NULL
) STRICT;
CREATE INDEX models_by_name ON models (name, created_at);

CREATE TABLE jobs (
    id          TEXT PRIMARY KEY,             -- `job-` and a UUIDv7
    kind        TEXT NOT NULL CHECK (kind IN ('training', 'evaluation')),
    request     TEXT NOT NULL,                -- JSON
    state       TEXT NOT NULL
        CHECK (state IN ('waiting', 'running', 'done', 'stopped', 'failed')),
    dataset     TEXT REFERENCES datasets (id),
    result      TEXT,                         -- JSON
    error       TEXT,
    asked_by    TEXT NOT NULL,
    created_at  TEXT NOT NULL,
    started_at  TEXT,
    finished_at TEXT,
    CHECK ((state = 'failed') = (error IS NOT NULL)),
    CHECK ((state = 'done') = (result IS NOT NULL))
) STRICT;
CREATE INDEX jobs_by_state ON jobs (state, id);

-- What serves from when on; the last row of a slot counts, and a NULL serves nothing.
CREATE TABLE promotions (
    id    INTEGER PRIMARY KEY AUTOINCREMENT,
    slot  TEXT NOT NULL CHECK (slot IN ('transfer', 'map', 'points', 'skin')),
    what  TEXT,                               -- a model's id, or a calibration's in the slot skin
    who   TEXT NOT NULL,
    why   TEXT,
    at    TEXT NOT NULL
) STRICT;
CREATE INDEX promotions_by_slot ON promotions (slot, id);
