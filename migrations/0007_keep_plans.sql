-- The plan that a run was queued with is kept: a resume whose plan would differ is refused, because
-- the trials of one run must come from one plan.
--
-- * plan: JSON, as `Plan::text` in src/bench/schedule/kept.rs writes it. Equal plans share a row.
-- * runs.plan_sha256 is NULL for runs that were queued before, until they are armed or resumed again,
--   and for imports, which have no plan.
CREATE TABLE plans (
    sha256 TEXT PRIMARY KEY,   -- of `plan`, 64 hexadecimal digits
    plan   TEXT NOT NULL
) STRICT;

ALTER TABLE runs ADD COLUMN plan_sha256 TEXT REFERENCES plans (sha256);
