-- A queued run may have an earliest start: a night begins when everybody has left, without a person.
--
-- * not_before is NULL for runs that may start at any time, and for runs that were queued before. It is
--   kept when the run starts.
ALTER TABLE runs ADD COLUMN not_before TEXT;
