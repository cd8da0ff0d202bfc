-- The least and the largest value of each column in blocks of 1024 ids: a condition that few trials meet reads the
-- blocks that may hold one, not every trial. `fvu < 0.0001` took 2.0 s for 3.4 million trials (docs/decisions/0016).
--
-- * block: the trials with ids from 1024 * block to 1024 * block + 1023.
-- * The columns have the names of the API. Text is bounded, too; a NULL meets no condition and bounds nothing.
-- * Bounds only widen. They stay when a trial is taken back, and are those of all twins of a trial, not of the newest
--   alone: a block may be read in vain, and no trial is missed.
-- * A later migration that makes `trials` or `twins` new creates their triggers again. One that adds a column to filter
--   by adds its bounds here, and a trigger that is like the first one for this column alone.
CREATE TABLE trial_blocks (
    block INTEGER PRIMARY KEY,
    scan_id_least ANY, scan_id_most ANY,
    configuration_least ANY, configuration_most ANY,
    depth_index_least ANY, depth_index_most ANY,
    attempt_least ANY, attempt_most ANY,
    depth_mm_least ANY, depth_mm_most ANY,
    tips_least ANY, tips_most ANY,
    contact_count_least ANY, contact_count_most ANY,
    max_force_n_least ANY, max_force_n_most ANY,
    flags_least ANY, flags_most ANY,
    saturated_channels_least ANY, saturated_channels_most ANY,
    stuck_channels_least ANY, stuck_channels_most ANY,
    missing_channels_least ANY, missing_channels_most ANY,
    injection_sum_v_least ANY, injection_sum_v_most ANY,
    dropped_packets_least ANY, dropped_packets_most ANY,
    depth_error_mm_least ANY, depth_error_mm_most ANY,
    settle_ms_least ANY, settle_ms_most ANY,
    overshoot_n_least ANY, overshoot_n_most ANY,
    frame_count_least ANY, frame_count_most ANY,
    started_at_least ANY, started_at_most ANY,
    measured_at_least ANY, measured_at_most ANY,
    imported_split_least ANY, imported_split_most ANY,
    imported_tag_least ANY, imported_tag_most ANY,
    rmse_v_least ANY, rmse_v_most ANY,
    fvu_least ANY, fvu_most ANY
) STRICT;

INSERT INTO trial_blocks (block) SELECT DISTINCT id >> 10 FROM trials;
REPLACE INTO trial_blocks
SELECT b.block,
    min(t.run), max(t.run),
    min(t.configuration), max(t.configuration),
    min(t.depth_index), max(t.depth_index),
    min(t.attempt), max(t.attempt),
    min(t.depth_mm), max(t.depth_mm),
    min(t.tips), max(t.tips),
    min(t.contact_count), max(t.contact_count),
    min(t.max_force_n), max(t.max_force_n),
    min(t.flags), max(t.flags),
    min(t.saturated_channels), max(t.saturated_channels),
    min(t.stuck_channels), max(t.stuck_channels),
    min(t.missing_channels), max(t.missing_channels),
    min(t.injection_sum_v), max(t.injection_sum_v),
    min(t.dropped_packets), max(t.dropped_packets),
    min(t.reached_z_mm - t.target_z_mm), max(t.reached_z_mm - t.target_z_mm),
    min(t.settle_ms), max(t.settle_ms),
    min(t.overshoot_n), max(t.overshoot_n),
    min(t.frame_count), max(t.frame_count),
    min(t.started_at), max(t.started_at),
    min(t.measured_at), max(t.measured_at),
    min(t.imported_split), max(t.imported_split),
    min(t.imported_tag), max(t.imported_tag),
    min(w.rmse_v), max(w.rmse_v),
    min(w.fvu), max(w.fvu)
FROM trial_blocks b CROSS JOIN trials t ON t.id BETWEEN b.block << 10 AND (b.block << 10) + 1023
LEFT JOIN twins w ON w.trial = t.id
GROUP BY b.block;

-- min and max of two values are NULL if one of them is.
CREATE TRIGGER trials_in_blocks AFTER INSERT ON trials BEGIN
    INSERT INTO trial_blocks (block) VALUES (new.id >> 10) ON CONFLICT DO NOTHING;
    UPDATE trial_blocks SET
        scan_id_least = coalesce(min(scan_id_least, new.run), scan_id_least, new.run),
        scan_id_most = coalesce(max(scan_id_most, new.run), scan_id_most, new.run),
        configuration_least =
            coalesce(min(configuration_least, new.configuration), configuration_least, new.configuration),
        configuration_most =
            coalesce(max(configuration_most, new.configuration), configuration_most, new.configuration),
        depth_index_least = coalesce(min(depth_index_least, new.depth_index), depth_index_least, new.depth_index),
        depth_index_most = coalesce(max(depth_index_most, new.depth_index), depth_index_most, new.depth_index),
        attempt_least = coalesce(min(attempt_least, new.attempt), attempt_least, new.attempt),
        attempt_most = coalesce(max(attempt_most, new.attempt), attempt_most, new.attempt),
        depth_mm_least = coalesce(min(depth_mm_least, new.depth_mm), depth_mm_least, new.depth_mm),
        depth_mm_most = coalesce(max(depth_mm_most, new.depth_mm), depth_mm_most, new.depth_mm),
        tips_least = coalesce(min(tips_least, new.tips), tips_least, new.tips),
        tips_most = coalesce(max(tips_most, new.tips), tips_most, new.tips),
        contact_count_least =
            coalesce(min(contact_count_least, new.contact_count), contact_count_least, new.contact_count),
        contact_count_most =
            coalesce(max(contact_count_most, new.contact_count), contact_count_most, new.contact_count),
        max_force_n_least = coalesce(min(max_force_n_least, new.max_force_n), max_force_n_least, new.max_force_n),
        max_force_n_most = coalesce(max(max_force_n_most, new.max_force_n), max_force_n_most, new.max_force_n),
        flags_least = coalesce(min(flags_least, new.flags), flags_least, new.flags),
        flags_most = coalesce(max(flags_most, new.flags), flags_most, new.flags),
        saturated_channels_least = coalesce(min(saturated_channels_least, new.saturated_channels),
            saturated_channels_least, new.saturated_channels),
        saturated_channels_most = coalesce(max(saturated_channels_most, new.saturated_channels),
            saturated_channels_most, new.saturated_channels),
        stuck_channels_least =
            coalesce(min(stuck_channels_least, new.stuck_channels), stuck_channels_least, new.stuck_channels),
        stuck_channels_most =
            coalesce(max(stuck_channels_most, new.stuck_channels), stuck_channels_most, new.stuck_channels),
        missing_channels_least =
            coalesce(min(missing_channels_least, new.missing_channels), missing_channels_least, new.missing_channels),
        missing_channels_most =
            coalesce(max(missing_channels_most, new.missing_channels), missing_channels_most, new.missing_channels),
        injection_sum_v_least =
            coalesce(min(injection_sum_v_least, new.injection_sum_v), injection_sum_v_least, new.injection_sum_v),
        injection_sum_v_most =
            coalesce(max(injection_sum_v_most, new.injection_sum_v), injection_sum_v_most, new.injection_sum_v),
        dropped_packets_least =
            coalesce(min(dropped_packets_least, new.dropped_packets), dropped_packets_least, new.dropped_packets),
        dropped_packets_most =
            coalesce(max(dropped_packets_most, new.dropped_packets), dropped_packets_most, new.dropped_packets),
        depth_error_mm_least = coalesce(min(depth_error_mm_least, new.reached_z_mm - new.target_z_mm),
            depth_error_mm_least, new.reached_z_mm - new.target_z_mm),
        depth_error_mm_most = coalesce(max(depth_error_mm_most, new.reached_z_mm - new.target_z_mm),
            depth_error_mm_most, new.reached_z_mm - new.target_z_mm),
        settle_ms_least = coalesce(min(settle_ms_least, new.settle_ms), settle_ms_least, new.settle_ms),
        settle_ms_most = coalesce(max(settle_ms_most, new.settle_ms), settle_ms_most, new.settle_ms),
        overshoot_n_least = coalesce(min(overshoot_n_least, new.overshoot_n), overshoot_n_least, new.overshoot_n),
        overshoot_n_most = coalesce(max(overshoot_n_most, new.overshoot_n), overshoot_n_most, new.overshoot_n),
        frame_count_least = coalesce(min(frame_count_least, new.frame_count), frame_count_least, new.frame_count),
        frame_count_most = coalesce(max(frame_count_most, new.frame_count), frame_count_most, new.frame_count),
        started_at_least = coalesce(min(started_at_least, new.started_at), started_at_least, new.started_at),
        started_at_most = coalesce(max(started_at_most, new.started_at), started_at_most, new.started_at),
        measured_at_least = coalesce(min(measured_at_least, new.measured_at), measured_at_least, new.measured_at),
        measured_at_most = coalesce(max(measured_at_most, new.measured_at), measured_at_most, new.measured_at),
        imported_split_least =
            coalesce(min(imported_split_least, new.imported_split), imported_split_least, new.imported_split),
        imported_split_most =
            coalesce(max(imported_split_most, new.imported_split), imported_split_most, new.imported_split),
        imported_tag_least = coalesce(min(imported_tag_least, new.imported_tag), imported_tag_least, new.imported_tag),
        imported_tag_most = coalesce(max(imported_tag_most, new.imported_tag), imported_tag_most, new.imported_tag)
    WHERE block = new.id >> 10;
END;

CREATE TRIGGER twins_in_blocks AFTER INSERT ON twins BEGIN
    UPDATE trial_blocks SET
        rmse_v_least = coalesce(min(rmse_v_least, new.rmse_v), rmse_v_least, new.rmse_v),
        rmse_v_most = coalesce(max(rmse_v_most, new.rmse_v), rmse_v_most, new.rmse_v),
        fvu_least = coalesce(min(fvu_least, new.fvu), fvu_least, new.fvu),
        fvu_most = coalesce(max(fvu_most, new.fvu), fvu_most, new.fvu)
    WHERE block = new.trial >> 10;
END;
