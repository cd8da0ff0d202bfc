-- The tag that an imported file states for a trial, such as its tip or its place: rows are selected and split
-- by it. NULL: the file states none, or the trial was measured here.
ALTER TABLE trials ADD COLUMN imported_tag TEXT
    CHECK (length(imported_tag) BETWEEN 1 AND 100);

DROP VIEW trials_flat;
CREATE VIEW trials_flat AS
SELECT t.id AS trial_id, r.uid AS run, t.run AS scan_id, r.experiment, r.label, t.configuration,
    t.depth_index, t.attempt, t.depth_mm, t.tips, t.contact_count, t.max_force_n,
    m.hash AS sim_model, w.rmse_v, w.fvu, t.flags, t.saturated_channels, t.stuck_channels,
    t.missing_channels, t.injection_sum_v, t.dropped_packets,
    (t.reached_z_mm - t.target_z_mm) AS depth_error_mm, t.settle_ms, t.overshoot_n, t.frame_count,
    t.started_at, t.measured_at, t.imported_split, t.imported_tag
FROM trials t
JOIN runs r ON r.scan_id = t.run
LEFT JOIN twins w ON w.trial = t.id
    AND w.model = (SELECT max(model) FROM twins n WHERE n.trial = t.id)
LEFT JOIN twin_models m ON m.id = w.model;
