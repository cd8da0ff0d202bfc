-- Frames of the untouched skin, measured before configurations and placements: the offsets of the readout
-- drift, and a trial is read relative to the last of them.
CREATE TABLE untouched_frames (
    id          INTEGER PRIMARY KEY,
    run         INTEGER NOT NULL REFERENCES runs (scan_id),
    at          TEXT    NOT NULL,
    frame_count INTEGER NOT NULL CHECK (frame_count >= 1),
    voltages_v  BLOB    NOT NULL,                     -- mean of the frames, V, little-endian f32
    crc32       INTEGER NOT NULL
) STRICT;
CREATE INDEX untouched_frames_of_run ON untouched_frames (run, at);
