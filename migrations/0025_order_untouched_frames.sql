-- The zero of a trial is the frame of the untouched skin that was stored last before it. Their times do not show which
-- one it is if the clock was set back between them.
--
-- * after_trial: id of the trial of the same run that was stored last before the frame; 0: none.
-- * Frames from before are placed among the trials by their times: nothing else of their order is stored.
ALTER TABLE untouched_frames ADD COLUMN after_trial INTEGER NOT NULL DEFAULT 0 CHECK (after_trial >= 0);
CREATE INDEX trials_started ON trials (run, started_at);
UPDATE untouched_frames AS u SET after_trial = coalesce(
    (SELECT t.id FROM trials t WHERE t.run = u.run AND t.started_at < u.at
     ORDER BY t.started_at DESC, t.id DESC LIMIT 1), 0);
DROP INDEX trials_started;
DROP INDEX untouched_frames_of_run;
CREATE INDEX untouched_frames_of_run ON untouched_frames (run, after_trial);
