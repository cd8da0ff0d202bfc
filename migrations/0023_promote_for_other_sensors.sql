-- A model of another sensor than the rig's may be promoted, too: a promotion states the sensor. NULL, in the rows from
-- before, is the rig's.
ALTER TABLE promotions ADD COLUMN sensor TEXT;
