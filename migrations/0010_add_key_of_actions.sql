-- The log of actions states the number of the API key: the name of a revoked key may be given to another
-- key, so that the name alone does not prove who acted.
--
-- * key_id is NULL for callers without a key, and for actions that were logged before.
ALTER TABLE actions ADD COLUMN key_id INTEGER REFERENCES api_keys (id);
