-- The bounds of blocks (migration 21) as they follow from the trials and twins of today, with the columns of
-- `trial_blocks` in the same order: wrong bounds are deleted and inserted again from here, whatever columns later
-- migrations bound (docs/how-to/run-overnight.md). Before, migration 21 itself was run again, which knows its own
-- columns alone.
--
-- A later migration that adds a column to filter by creates this view again, with the bounds of the column last.
CREATE VIEW trial_bounds AS
SELECT t.id >> 10 AS block,
    min(t.run) AS scan_id_least, max(t.run) AS scan_id_most,
    min(t.configuration) AS configuration_least, max(t.configuration) AS configuration_most,
    min(t.depth_index) AS depth_index_least, max(t.depth_index) AS depth_index_most,
    min(t.attempt) AS attempt_least, max(t.attempt) AS attempt_most,
    min(t.depth_mm) AS depth_mm_least, max(t.depth_mm) AS depth_mm_most,
    min(t.tips) AS tips_least, max(t.tips) AS tips_most,
    min(t.contact_count) AS contact_count_least, max(t.contact_count) AS contact_count_most,
    min(t.max_force_n) AS max_force_n_least, max(t.max_force_n) AS max_force_n_most,
    min(t.flags) AS flags_least, max(t.flags) AS flags_most,
    min(t.saturated_channels) AS saturated_channels_least, max(t.saturated_channels) AS saturated_channels_most,
    min(t.stuck_channels) AS stuck_channels_least, max(t.stuck_channels) AS stuck_channels_most,
    min(t.missing_channels) AS missing_channels_least, max(t.missing_channels) AS missing_channels_most,
    min(t.injection_sum_v) AS injection_sum_v_least, max(t.injection_sum_v) AS injection_sum_v_most,
    min(t.dropped_packets) AS dropped_packets_least, max(t.dropped_packets) AS dropped_packets_most,
    min(t.reached_z_mm - t.target_z_mm) AS depth_error_mm_least,
    max(t.reached_z_mm - t.target_z_mm) AS depth_error_mm_most,
    min(t.settle_ms) AS settle_ms_least, max(t.settle_ms) AS settle_ms_most,
    min(t.overshoot_n) AS overshoot_n_least, max(t.overshoot_n) AS overshoot_n_most,
    min(t.frame_count) AS frame_count_least, max(t.frame_count) AS frame_count_most,
    min(t.started_at) AS started_at_least, max(t.started_at) AS started_at_most,
    min(t.measured_at) AS measured_at_least, max(t.measured_at) AS measured_at_most,
    min(t.imported_split) AS imported_split_least, max(t.imported_split) AS imported_split_most,
    min(t.imported_tag) AS imported_tag_least, max(t.imported_tag) AS imported_tag_most,
    min(w.rmse_v) AS rmse_v_least, max(w.rmse_v) AS rmse_v_most,
    min(w.fvu) AS fvu_least, max(w.fvu) AS fvu_most
FROM trials t
LEFT JOIN twins w ON w.trial = t.id
GROUP BY t.id >> 10;
