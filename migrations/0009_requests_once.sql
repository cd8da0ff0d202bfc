-- A request with an `Idempotency-Key` is carried out once; a repetition gets the first response.
--
-- * caller: number of the API key; 0 for callers without one.
-- * request: sha256 of method, path, query and body, 64 hexadecimal digits.
-- * status, location, content_type, body: the response. status and body are NULL until it is stored; they
--   stay NULL if the service ends before, or if the response is too large.
-- * A refused request leaves no row. Old rows are removed when a row is added.
CREATE TABLE requests_once (
    id           INTEGER PRIMARY KEY,
    caller       INTEGER NOT NULL,
    name         TEXT    NOT NULL,             -- the key that the client chose
    request      TEXT    NOT NULL,
    began_at     TEXT    NOT NULL,
    status       INTEGER,
    location     TEXT,
    content_type TEXT,
    body         BLOB,
    UNIQUE (caller, name),
    CHECK ((status IS NULL) = (body IS NULL))
) STRICT;
CREATE INDEX requests_once_by_age ON requests_once (began_at);
