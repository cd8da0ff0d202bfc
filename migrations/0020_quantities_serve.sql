-- Nets that answer a quantity of a whole frame (position, pattern, count, force) may serve, too: four more slots.
-- A CHECK cannot be changed in place, so the table is copied.
CREATE TABLE promotions_anew (
    id    INTEGER PRIMARY KEY AUTOINCREMENT,
    slot  TEXT NOT NULL CHECK (slot IN
        ('transfer', 'map', 'points', 'skin', 'position', 'pattern', 'count', 'force')),
    what  TEXT,                               -- a model's id, or a calibration's in the slot skin
    who   TEXT NOT NULL,
    why   TEXT,
    at    TEXT NOT NULL,
    rolled_back INTEGER NOT NULL DEFAULT 0 CHECK (rolled_back IN (0, 1))
) STRICT;
INSERT INTO promotions_anew (id, slot, what, who, why, at, rolled_back)
    SELECT id, slot, what, who, why, at, rolled_back FROM promotions;
DROP TABLE promotions;
ALTER TABLE promotions_anew RENAME TO promotions;
CREATE INDEX promotions_by_slot ON promotions (slot, id);
