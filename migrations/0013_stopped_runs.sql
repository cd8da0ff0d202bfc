-- no-transaction
-- A run that is stopped before the end of its plan.
--
-- Why this shape:
-- * 'stopped' is an exit status of its own: a run that ends short of its plan is no success, and it
--   can be resumed. SQLite changes a CHECK only by making the table anew. With foreign keys off
--   nothing refers to the old one meanwhile; it is one transaction, and doing it twice does no harm.
-- * Runs that were stopped before are stored as 'success' with the reason 'requested'. Their trials
--   tell how far they came; what is stored of them stays as it is.
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
    exit_status        TEXT    CHECK (exit_status IN ('success', 'stopped', 'abort', 'fail')),
    reason             TEXT,
    queue_position     INTEGER,
    created_at         TEXT    NOT NULL,
    started_at         TEXT,
    ended_at           TEXT,
    submitted_by       TEXT    NOT NULL,
    waiting_since      TEXT,
    plan_sha256        TEXT    REFERENCES plans (sha256),
    not_before         TEXT,
    CHECK ((state = 'queued') = (queue_position IS NOT NULL)),
    CHECK ((state = 'ended') = (exit_status IS NOT NULL)),
    CHECK (kind = 'imported' OR (seed IS NOT NULL AND rig IS NOT NULL AND rig_sha256 IS NOT NULL))
) STRICT;
INSERT INTO runs_anew
    SELECT scan_id, uid, experiment, kind, definition, definition_sha256, seed, rig, rig_sha256,
        sensor, sensor_sha256, calibration_id, label, version, git_commit, deadband_n,
        tip_diameter_mm, trials_planned, auto_resume, state, requested_state, paused_why,
        exit_status, reason, queue_position, created_at, started_at, ended_at, submitted_by,
        waiting_since, plan_sha256, not_before
    FROM runs;
DROP TABLE runs;
ALTER TABLE runs_anew RENAME TO runs;

COMMIT;

PRAGMA foreign_keys = ON;
