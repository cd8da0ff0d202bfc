-- no-transaction
-- Trials measured elsewhere, what is known of a frame's quality, datasets and their exports.
--
-- Why these shapes:
-- * An import is a run like any other, so that everything after acquisition works on it. It has no
--   rig, no seed and no raw frames, and may lack times and forces: those columns become nullable,
--   which SQLite does only by making the tables anew. With foreign keys off nothing refers to the
--   old ones meanwhile; it is one transaction, and doing it twice does no harm.
-- * Quality is counted when the frames are in hand. Trials stored before have NULL: not looked at.
-- * A dataset's rows are a file, named by its id; here stands what it was made from. The file of an
--   id never changes, so neither does its row.
-- * An export is a wish. What became of it is a file named by its contents' key: a wish that a kill
--   interrupted is carried out again and gives the same bytes.
PRAGMA foreign_keys = OFF;

BEGIN;

CREATE TABLE runs_anew (
    scan_id            INTEGER PRIMARY KEY,
    uid                TEXT    NOT NULL UNIQUE,
    experiment         TEXT    NOT NULL,
    kind               TEXT    NOT NULL CHECK (kind IN ('real-hex', 'real-random', 'imported')),
    definition         TEXT    NOT NULL,
    definition_sha256  TEXT    NOT NULL,
    seed               INTEGER,
    rig                TEXT,
    rig_sha256         TEXT,
    sensor             TEXT    NOT NULL,
    sensor_sha256      TEXT    NOT NULL,
    calibration_id     TEXT,
    label              TEXT    NOT NULL CHECK (label IN ('measured', 'virtual', 'simulated')),
    version            TEXT    NOT NULL,
    git_commit         TEXT,
    deadband_n         REAL    NOT NULL CHECK (deadband_n >= 0),
    tip_diameter_mm    REAL    CHECK (tip_diameter_mm > 0),
    trials_planned     INTEGER NOT NULL CHECK (trials_planned >= 0),
    auto_resume        INTEGER NOT NULL CHECK (auto_resume IN (0, 1)),
    state              TEXT    NOT NULL,
    requested_state    TEXT,
    paused_why         TEXT,
    exit_status        TEXT    CHECK (exit_status IN ('success', 'abort', 'fail')),
    reason             TEXT,
    queue_position     INTEGER,
    created_at         TEXT    NOT NULL,
    started_at         TEXT,
    ended_at           TEXT,
    submitted_by       TEXT    NOT NULL,
    CHECK ((state = 'queued') = (queue_position IS NOT NULL)),
    CHECK ((state = 'ended') = (exit_status IS NOT NULL)),
    CHECK (kind = 'imported' OR (seed IS NOT NULL AND rig IS NOT NULL AND rig_sha256 IS NOT NULL))
) STRICT;
INSERT INTO runs_anew
    SELECT scan_id, uid, experiment, kind, definition, definition_sha256, seed, rig, rig_sha256,
        sensor, sensor_sha256, calibration_id, label, version, git_commit, deadband_n,
        tip_diameter_mm, trials_planned, auto_resume, state, requested_state, paused_why,
        exit_status, reason, queue_position, created_at, started_at, ended_at, submitted_by
    FROM runs;
DROP TABLE runs;
ALTER TABLE runs_anew RENAME TO runs;

CREATE TABLE trials_anew (
    id            INTEGER PRIMARY KEY AUTOINCREMENT,
    run           INTEGER NOT NULL REFERENCES runs (scan_id),
    configuration INTEGER NOT NULL CHECK (configuration >= 0),
    depth_index   INTEGER NOT NULL CHECK (depth_index >= 0),
    attempt       INTEGER NOT NULL CHECK (attempt >= 1),
    tips          INTEGER NOT NULL CHECK (tips >= 0),
    depth_mm      REAL,
    target_x_mm   REAL, target_y_mm   REAL, target_z_mm   REAL, target_radius_mm   REAL,
    reached_x_mm  REAL, reached_y_mm  REAL, reached_z_mm  REAL, reached_radius_mm  REAL,
    placed_by     TEXT,
    flags         TEXT    NOT NULL,
    settle_ms     REAL,
    overshoot_n   REAL,
    contact_count INTEGER NOT NULL CHECK (contact_count >= 0),
    max_force_n   REAL,
    frame_count   INTEGER NOT NULL CHECK (frame_count >= 0),
    started_at    TEXT,
    measured_at   TEXT,
    saturated_channels INTEGER,
    stuck_channels     INTEGER,
    missing_channels   INTEGER,
    injection_sum_v    REAL,
    dropped_packets    INTEGER,
    UNIQUE (run, configuration, depth_index)
) STRICT;
INSERT INTO trials_anew
    SELECT id, run, configuration, depth_index, attempt, tips, depth_mm, target_x_mm, target_y_mm,
        target_z_mm, target_radius_mm, reached_x_mm, reached_y_mm, reached_z_mm, reached_radius_mm,
        placed_by, flags, settle_ms, overshoot_n, contact_count, max_force_n, frame_count,
        started_at, measured_at, NULL, NULL, NULL, NULL, NULL
    FROM trials;
-- The id of a trial that was taken back is never given to another, also not from now on.
DELETE FROM sqlite_sequence WHERE name = 'trials_anew';
INSERT INTO sqlite_sequence SELECT 'trials_anew', seq FROM sqlite_sequence WHERE name = 'trials';
DROP TABLE trials;
ALTER TABLE trials_anew RENAME TO trials;
CREATE INDEX trials_in_order ON trials (run, id, tips, contact_count);
CREATE INDEX trials_by_contacts ON trials (contact_count, max_force_n);

-- Contacts as they were placed or imported: what is not known of one is NULL.
CREATE TABLE placed_contacts_anew (
    trial       INTEGER NOT NULL REFERENCES trials (id) ON DELETE CASCADE,
    n           INTEGER NOT NULL,
    x_mm        REAL,
    y_mm        REAL,
    force_n     REAL,
    diameter_mm REAL,
    PRIMARY KEY (trial, n)
) STRICT, WITHOUT ROWID;
INSERT INTO placed_contacts_anew
    SELECT trial, n, x_mm, y_mm, force_n, NULL FROM placed_contacts;
DROP TABLE placed_contacts;
ALTER TABLE placed_contacts_anew RENAME TO placed_contacts;

CREATE TABLE IF NOT EXISTS datasets (
    id           TEXT    PRIMARY KEY,         -- `ds-` and the start of a sha256 over its contents
    name         TEXT    NOT NULL,
    definition   TEXT    NOT NULL,            -- JSON
    rows         INTEGER NOT NULL,
    bytes        INTEGER NOT NULL,            -- of its Parquet file
    sha256       TEXT    NOT NULL,            -- of its Parquet file
    report       TEXT    NOT NULL,            -- JSON: splits, what was left out, schema
    lineage      TEXT    NOT NULL,            -- JSON: runs, models, calibrations, shards, code
    created_at   TEXT    NOT NULL
) STRICT;
CREATE INDEX IF NOT EXISTS datasets_by_name ON datasets (name, created_at);

-- Which dataset a definition gave on stored trials in this state; so that asking twice is quick.
CREATE TABLE IF NOT EXISTS dataset_inputs (
    inputs  TEXT PRIMARY KEY,                 -- sha256 over definition and state
    dataset TEXT NOT NULL REFERENCES datasets (id)
) STRICT, WITHOUT ROWID;

CREATE TABLE IF NOT EXISTS exports (
    id          TEXT    PRIMARY KEY,          -- `ex-` and a UUIDv7
    request     TEXT    NOT NULL,             -- JSON
    state       TEXT    NOT NULL CHECK (state IN ('waiting', 'running', 'done', 'failed')),
    dataset     TEXT    REFERENCES datasets (id),
    file        TEXT,                         -- its name; shared by equal exports
    bytes       INTEGER,
    sha256      TEXT,
    error       TEXT,
    asked_by    TEXT    NOT NULL,
    created_at  TEXT    NOT NULL,
    finished_at TEXT,
    CHECK ((state = 'done') = (file IS NOT NULL AND bytes IS NOT NULL AND sha256 IS NOT NULL)),
    CHECK ((state = 'failed') = (error IS NOT NULL))
) STRICT;
CREATE INDEX IF NOT EXISTS exports_by_state ON exports (state, created_at);

COMMIT;

PRAGMA foreign_keys = ON;
