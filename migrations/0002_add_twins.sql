-- The simulated twins of stored trials.
--
-- There is no job row: a twin is pending while no row (trial, model) exists (law 1), so none can be
-- forgotten or computed into a second row. Voltages sit in a table of their own, as the measured
-- ones do, so that a scan over the fits reads no frames. The trial comes first in the keys: taking a
-- trial back, and asking for what is pending, then touch one page.

CREATE TABLE twin_models (
    id             INTEGER PRIMARY KEY,        -- `model` in the tables below; a later one is newer
    hash           TEXT    NOT NULL UNIQUE,    -- `sim-..`: sensor, responses, fields, circuit
    sensor_sha256  TEXT    NOT NULL,
    calibration_id TEXT,
    version        TEXT    NOT NULL,
    git_commit     TEXT,
    created_at     TEXT    NOT NULL
) STRICT;

CREATE TABLE twins (
    trial       INTEGER NOT NULL REFERENCES trials (id) ON DELETE CASCADE,
    model       INTEGER NOT NULL REFERENCES twin_models (id),
    rmse_v      REAL,                          -- both NULL where there is no frame to compare
    fvu         REAL,                          -- NULL too where the measured frame is constant
    failure     TEXT,                          -- why the model could not take the trial
    computed_at TEXT    NOT NULL,
    PRIMARY KEY (trial, model)
) STRICT, WITHOUT ROWID;

-- Little-endian f32, volts, injection-major.
CREATE TABLE twin_voltages (
    trial      INTEGER NOT NULL REFERENCES trials (id) ON DELETE CASCADE,
    model      INTEGER NOT NULL REFERENCES twin_models (id),
    voltages_v BLOB    NOT NULL,
    PRIMARY KEY (trial, model)
) STRICT, WITHOUT ROWID;
