-- Pages and `palpate status --watch` read the last events of some kinds, wherever they are. Without this index each
-- question about a rare kind reads the whole table: 0.1 s for a million events.
CREATE INDEX events_of_kind ON events (kind);
