-- After the voltage stream was opened again, or its device was switched off and on, the offsets may be others: frames of
-- the untouched skin from before are in no mean with those after it.
--
-- * stream_since: wall time since which the stream was open and its device had not restarted; NULL: not known.
ALTER TABLE untouched_frames ADD COLUMN stream_since TEXT;
