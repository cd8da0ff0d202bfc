-- The records of a rig: what was planned, what was measured, what failed, who did what.
--
-- Why these shapes:
-- * A trial's key (run, configuration, depth_index) is unique here, so that no crash, retry or
--   resume can store it twice (law 1); everything of a trial goes in with it in one transaction.
-- * Raw forces and raw frames are kept as they came. contact_count and max_force_n are derived from
--   them with runs.deadband_n at insert, only so that they can be indexed.
-- * Mean voltages and frames sit in tables of their own: a scan over 198,000 trials' numbers then
--   reads 30 MB, not a gigabyte.
-- * Tables keyed by (parent, n) are WITHOUT ROWID: a commit touches one page for them, not two.

CREATE TABLE runs (
    scan_id            INTEGER PRIMARY KEY,   -- the human number; `run` in every other table
    uid                TEXT    NOT NULL UNIQUE,
    experiment         TEXT    NOT NULL,
    kind               TEXT    NOT NULL CHECK (kind IN ('real-hex', 'real-random')),
    -- Provenance: the files as they were, so that any number can be walked back.
    definition         TEXT    NOT NULL,
    definition_sha256  TEXT    NOT NULL,
    seed               INTEGER NOT NULL,
    rig                TEXT    NOT NULL,
    rig_sha256         TEXT    NOT NULL,
    sensor             TEXT    NOT NULL,
    sensor_sha256      TEXT    NOT NULL,
    calibration_id     TEXT,
    label              TEXT    NOT NULL CHECK (label IN ('measured', 'virtual')),
    version            TEXT    NOT NULL,
    git_commit         TEXT,
    -- What turns raw forces into contacts.
    deadband_n         REAL    NOT NULL CHECK (deadband_n >= 0),
    tip_diameter_mm    REAL    CHECK (tip_diameter_mm > 0),
    trials_planned     INTEGER NOT NULL CHECK (trials_planned >= 0),
    auto_resume        INTEGER NOT NULL CHECK (auto_resume IN (0, 1)),
    -- 'queued', a state of the engine, 'interrupted', 'ended' or 'removed'.
    state              TEXT    NOT NULL,
    requested_state    TEXT,
    paused_why         TEXT,
    exit_status        TEXT    CHECK (exit_status IN ('success', 'abort', 'fail')),
    reason             TEXT,
    queue_position     INTEGER,               -- from 1, present while the state is 'queued'
    created_at         TEXT    NOT NULL,
    started_at         TEXT,
    ended_at           TEXT,
    submitted_by       TEXT    NOT NULL,
    CHECK ((state = 'queued') = (queue_position IS NOT NULL)),
    CHECK ((state = 'ended') = (exit_status IS NOT NULL))
) STRICT;

CREATE TABLE trials (
    -- AUTOINCREMENT: the id of a trial that was taken back is never given to another.
    id            INTEGER PRIMARY KEY AUTOINCREMENT,
    run           INTEGER NOT NULL REFERENCES runs (scan_id),
    configuration INTEGER NOT NULL CHECK (configuration >= 0),
    depth_index   INTEGER NOT NULL CHECK (depth_index >= 0),
    attempt       INTEGER NOT NULL CHECK (attempt >= 1),
    tips          INTEGER NOT NULL CHECK (tips BETWEEN 0 AND 6),
    depth_mm      REAL,
    target_x_mm   REAL, target_y_mm   REAL, target_z_mm   REAL, target_radius_mm   REAL,
    reached_x_mm  REAL, reached_y_mm  REAL, reached_z_mm  REAL, reached_radius_mm  REAL,
    placed_by     TEXT,
    flags         TEXT    NOT NULL,           -- JSON array of words
    settle_ms     REAL    NOT NULL,
    overshoot_n   REAL,
    contact_count INTEGER NOT NULL CHECK (contact_count BETWEEN 0 AND 6),
    max_force_n   REAL,                       -- largest raw force, also when under the deadband
    frame_count   INTEGER NOT NULL CHECK (frame_count >= 1),
    started_at    TEXT    NOT NULL,
    measured_at   TEXT    NOT NULL,
    UNIQUE (run, configuration, depth_index)
) STRICT;

-- A run's trials in the order in which they were stored, and its counts, from the index alone.
CREATE INDEX trials_in_order ON trials (run, id, tips, contact_count);
-- "Three contacts and more than 10 N" (stack.md, part 2: 40 times faster than a scan).
CREATE INDEX trials_by_contacts ON trials (contact_count, max_force_n);

-- Every attached tip with its raw force; relabelling with another deadband starts here.
CREATE TABLE trial_tips (
    trial   INTEGER NOT NULL REFERENCES trials (id) ON DELETE CASCADE,
    arm     INTEGER NOT NULL CHECK (arm BETWEEN 1 AND 6),
    x_mm    REAL    NOT NULL,
    y_mm    REAL    NOT NULL,
    force_n REAL    NOT NULL,
    cell_v  REAL    NOT NULL,
    tare_v  REAL    NOT NULL,
    PRIMARY KEY (trial, arm)
) STRICT, WITHOUT ROWID;

-- Weights placed by hand, at their nominal force.
CREATE TABLE placed_contacts (
    trial   INTEGER NOT NULL REFERENCES trials (id) ON DELETE CASCADE,
    n       INTEGER NOT NULL,
    x_mm    REAL    NOT NULL,
    y_mm    REAL    NOT NULL,
    force_n REAL    NOT NULL,
    PRIMARY KEY (trial, n)
) STRICT, WITHOUT ROWID;

-- Mean of a trial's frames: little-endian f32, volts, injection-major.
CREATE TABLE trial_voltages (
    trial      INTEGER PRIMARY KEY REFERENCES trials (id) ON DELETE CASCADE,
    voltages_v BLOB NOT NULL
) STRICT;

-- Raw frames: little-endian i16 counts, injection-major.
CREATE TABLE frames (
    trial           INTEGER NOT NULL REFERENCES trials (id) ON DELETE CASCADE,
    n               INTEGER NOT NULL,
    sequence        INTEGER NOT NULL,
    device_time_us  INTEGER NOT NULL,
    volts_per_count REAL    NOT NULL,
    counts          BLOB    NOT NULL,
    PRIMARY KEY (trial, n)
) STRICT, WITHOUT ROWID;

-- Tries that did not become trials, and trials that were taken back (those with `trial`).
CREATE TABLE attempts (
    id            INTEGER PRIMARY KEY,
    run           INTEGER NOT NULL REFERENCES runs (scan_id),
    configuration INTEGER NOT NULL,
    depth_index   INTEGER NOT NULL,
    attempt       INTEGER NOT NULL,
    reason        TEXT    NOT NULL,
    at            TEXT    NOT NULL,
    trial         INTEGER UNIQUE,             -- the id that the trial had
    record        TEXT                        -- the trial as JSON
) STRICT;
CREATE INDEX attempts_of_run ON attempts (run);

CREATE TABLE attempt_frames (
    attempt         INTEGER NOT NULL REFERENCES attempts (id),
    n               INTEGER NOT NULL,
    sequence        INTEGER NOT NULL,
    device_time_us  INTEGER NOT NULL,
    volts_per_count REAL    NOT NULL,
    counts          BLOB    NOT NULL,
    PRIMARY KEY (attempt, n)
) STRICT, WITHOUT ROWID;

CREATE TABLE skips (
    run           INTEGER NOT NULL REFERENCES runs (scan_id),
    configuration INTEGER NOT NULL,
    reason        TEXT    NOT NULL,
    at            TEXT    NOT NULL,
    PRIMARY KEY (run, configuration)
) STRICT, WITHOUT ROWID;

-- Zeros of the cells before a configuration.
CREATE TABLE tares (
    id            INTEGER PRIMARY KEY,
    run           INTEGER NOT NULL REFERENCES runs (scan_id),
    configuration INTEGER NOT NULL,
    samples       INTEGER NOT NULL,
    at            TEXT    NOT NULL
) STRICT;
CREATE INDEX tares_of_run ON tares (run);

CREATE TABLE tare_arms (
    tare   INTEGER NOT NULL REFERENCES tares (id),
    arm    INTEGER NOT NULL CHECK (arm BETWEEN 1 AND 6),
    cell_v REAL    NOT NULL,
    PRIMARY KEY (tare, arm)
) STRICT, WITHOUT ROWID;

-- The same place pressed at stated intervals, to tell drift from position.
CREATE TABLE reference_presses (
    id                   INTEGER PRIMARY KEY,
    run                  INTEGER NOT NULL REFERENCES runs (scan_id),
    before_configuration INTEGER NOT NULL,
    reached_x_mm REAL NOT NULL, reached_y_mm REAL NOT NULL,
    reached_z_mm REAL NOT NULL, reached_radius_mm REAL NOT NULL,
    depth_mm             REAL    NOT NULL,
    sequence             INTEGER NOT NULL,
    device_time_us       INTEGER NOT NULL,
    volts_per_count      REAL    NOT NULL,
    counts               BLOB    NOT NULL,
    at                   TEXT    NOT NULL
) STRICT;
CREATE INDEX reference_presses_of_run ON reference_presses (run);

CREATE TABLE reference_tips (
    press   INTEGER NOT NULL REFERENCES reference_presses (id),
    arm     INTEGER NOT NULL CHECK (arm BETWEEN 1 AND 6),
    x_mm    REAL    NOT NULL,
    y_mm    REAL    NOT NULL,
    force_n REAL    NOT NULL,
    cell_v  REAL    NOT NULL,
    tare_v  REAL    NOT NULL,
    PRIMARY KEY (press, arm)
) STRICT, WITHOUT ROWID;

-- The surface as found after a tip change.
CREATE TABLE touch_offs (
    id              INTEGER PRIMARY KEY,
    run             INTEGER NOT NULL REFERENCES runs (scan_id),
    tips            INTEGER NOT NULL,
    surface_z_mm    REAL    NOT NULL,
    tip_offsets_mm  TEXT    NOT NULL,         -- JSON [[arm, offset_mm], ..]
    touches_mm      TEXT    NOT NULL,         -- JSON [[x_mm, y_mm, arm, z_mm], ..]
    at              TEXT    NOT NULL
) STRICT;
CREATE INDEX touch_offs_of_run ON touch_offs (run);

-- What happened, for people and for live pages; numbers are never given twice.
CREATE TABLE events (
    seq  INTEGER PRIMARY KEY AUTOINCREMENT,
    run  INTEGER REFERENCES runs (scan_id),
    at   TEXT    NOT NULL,
    kind TEXT    NOT NULL,
    data TEXT    NOT NULL
) STRICT;
CREATE INDEX events_of_run ON events (run);

-- Who asked for what, when, why, and whether it was allowed.
CREATE TABLE actions (
    id       INTEGER PRIMARY KEY,
    at       TEXT    NOT NULL,
    run      INTEGER REFERENCES runs (scan_id),
    action   TEXT    NOT NULL,
    who      TEXT    NOT NULL,
    why      TEXT,
    accepted INTEGER NOT NULL CHECK (accepted IN (0, 1)),
    detail   TEXT
) STRICT;
CREATE INDEX actions_of_run ON actions (run);

-- Only hashes: a stolen database opens no door.
CREATE TABLE api_keys (
    id           INTEGER PRIMARY KEY,
    name         TEXT NOT NULL,
    sha256       TEXT NOT NULL UNIQUE,
    role         TEXT NOT NULL CHECK (role IN ('viewer', 'operator', 'admin')),
    created_at   TEXT NOT NULL,
    last_used_at TEXT,
    revoked_at   TEXT
) STRICT;

-- At most one row: while it is there, starting and editing are blocked; stopping never is.
CREATE TABLE operator_lock (
    id     INTEGER PRIMARY KEY CHECK (id = 1),
    holder TEXT NOT NULL,
    note   TEXT NOT NULL,
    since  TEXT NOT NULL
) STRICT;

CREATE TABLE settings (
    name       TEXT PRIMARY KEY,
    value      TEXT NOT NULL,
    updated_at TEXT NOT NULL
) STRICT, WITHOUT ROWID;
