-- Views for programs that read the database themselves (Datasette, DB browsers): one row for each trial
-- and for each run, with the names of the API. docs/columns.md explains the columns of trials.
--
-- A later migration that makes one of these tables anew drops the views first, and creates them again.
CREATE VIEW trials_flat AS
SELECT t.id AS trial_id, r.uid AS run, t.run AS scan_id, r.experiment, r.label, t.configuration,
    t.depth_index, t.attempt, t.depth_mm, t.tips, t.contact_count, t.max_force_n,
    m.hash AS sim_model, w.rmse_v, w.fvu, t.flags, t.saturated_channels, t.stuck_channels,
    t.missing_channels, t.injection_sum_v, t.dropped_packets,
    (t.reached_z_mm - t.target_z_mm) AS depth_error_mm, t.settle_ms, t.overshoot_n, t.frame_count,
    t.started_at, t.measured_at
FROM trials t
JOIN runs r ON r.scan_id = t.run
LEFT JOIN twins w ON w.trial = t.id
    AND w.model = (SELECT max(model) FROM twins n WHERE n.trial = t.id)
LEFT JOIN twin_models m ON m.id = w.model;

CREATE VIEW runs_flat AS
SELECT r.scan_id, r.uid AS run, r.experiment, r.kind, r.label, r.state, r.exit_status, r.reason,
    r.trials_planned, (SELECT count(*) FROM trials t WHERE t.run = r.scan_id) AS trials_stored,
    r.deadband_n, r.tip_diameter_mm, r.calibration_id, r.seed, r.version, r.submitted_by,
    r.created_at, r.started_at, r.ended_at
FROM runs r;
