-- Pages of trials with a number of contacts are in the order of their ids: the index of migration 1 held
-- them in the order of their forces, and SQLite sorted all of them for each page.
DROP INDEX trials_by_contacts;
CREATE INDEX trials_by_contacts ON trials (contact_count, id, max_force_n);
