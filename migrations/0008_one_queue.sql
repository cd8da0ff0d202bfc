-- One queue for all long work: exports, trainings and evaluations are tasks.
--
-- * `exports` and `jobs` had the same columns, states and rules, and were read by two workers with the
--   same loop. One table has one set of rules.
-- * File, bytes and sha256 of an export become its result, as JSON: a task that is done has a result,
--   of whatever kind it is.
-- * Ids do not change. When an export first started was not recorded: NULL.
-- * The old tables stay as they were at this migration, and are no longer read or written.
CREATE TABLE tasks (
    id          TEXT PRIMARY KEY,             -- `ex-` (exports) or `job-`, and a UUIDv7
    kind        TEXT NOT NULL CHECK (kind IN ('export', 'training', 'evaluation')),
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
CREATE INDEX tasks_by_state ON tasks (state, id);

INSERT INTO tasks (id, kind, request, state, dataset, result, error, asked_by, created_at, finished_at)
    SELECT id, 'export', request, state, dataset,
        CASE state WHEN 'done'
            THEN json_object('file', file, 'bytes', bytes, 'sha256', sha256) END,
        error, asked_by, created_at, finished_at
    FROM exports;

INSERT INTO tasks (id, kind, request, state, dataset, result, error, asked_by, created_at, started_at,
        finished_at)
    SELECT id, kind, request, state, dataset, result, error, asked_by, created_at, started_at,
        finished_at
    FROM jobs;
