-- Damage is found, and what a person said or started outlives a crash.
--
-- * crc32: IEEE, over what was measured, computed when it is stored and compared whenever it is read
--   (src/store/checksum.rs says over which bytes). A trial's own covers its row, tips and contacts.
--   Rows that were stored before have NULL: there is nothing to compare them with.
-- * How many tips are mounted is what a person says, beside how many cells were on their cables; the
--   last row counts.
-- * A run that was armed and started while another was under way waits for its turn: since when.
ALTER TABLE trials ADD COLUMN crc32 INTEGER;
ALTER TABLE trial_voltages ADD COLUMN crc32 INTEGER;
ALTER TABLE frames ADD COLUMN crc32 INTEGER;
ALTER TABLE attempt_frames ADD COLUMN crc32 INTEGER;
ALTER TABLE reference_presses ADD COLUMN crc32 INTEGER;
ALTER TABLE twin_voltages ADD COLUMN crc32 INTEGER;

ALTER TABLE runs ADD COLUMN waiting_since TEXT;

CREATE TABLE mountings (
    id         INTEGER PRIMARY KEY,
    tips       INTEGER NOT NULL CHECK (tips BETWEEN 0 AND 6),
    live_cells INTEGER NOT NULL CHECK (live_cells BETWEEN tips AND 6),
    who        TEXT    NOT NULL,
    at         TEXT    NOT NULL
) STRICT;
