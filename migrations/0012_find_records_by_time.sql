-- The history of a run needs the last record before each restart of the service, and trials and forces by
-- time. Without these indexes each of them reads the whole run: a run with thousands of states took minutes.
CREATE INDEX trials_over_time ON trials (run, measured_at, max_force_n);
CREATE INDEX events_over_time ON events (run, at);
