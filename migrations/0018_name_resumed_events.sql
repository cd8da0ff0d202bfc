-- The events after a start of the service have kinds in the terms of docs/words.md ("resume").
-- Numbers, times and data of stored events do not change.
UPDATE events SET kind = 'resumed' WHERE kind = 'went_on';
UPDATE events SET kind = 'not_resumed' WHERE kind = 'not_gone_on';
