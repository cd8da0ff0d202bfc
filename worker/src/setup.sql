-- Rights of workers: `palpate-worker setup` applies this file after it has made the tables of the queue.
-- The role that runs it owns the tables: it submits, watches and cancels. Its password is the lab's secret.
--
-- palpate_worker is a group without a password. A lab makes one login per machine or person:
--
--     CREATE ROLE desk_1 LOGIN PASSWORD '..' IN ROLE palpate_worker;
--
-- Such a login can take, return and acknowledge chunks, and renew leases. It cannot submit, see other tables, or
-- change an order's priority, attempts or needs. It can delay or drop chunks of the queue; a result is accepted
-- only with the hash that it states, and a dropped chunk is missing in `status` until it is submitted again.

DO $$
BEGIN
    IF NOT EXISTS (SELECT FROM pg_roles WHERE rolname = 'palpate_worker') THEN
        CREATE ROLE palpate_worker NOLOGIN;
    END IF;
END
$$;

REVOKE ALL ON SCHEMA palpate_queue FROM PUBLIC;
REVOKE ALL ON ALL TABLES IN SCHEMA palpate_queue FROM PUBLIC, palpate_worker;
GRANT USAGE ON SCHEMA palpate_queue TO palpate_worker;

-- The orders; each is a task of the queue.
GRANT SELECT ON palpate_queue._private_tasks TO palpate_worker;

-- Take, return, acknowledge. Not: INSERT, key, priority, max_attempts, flags.
GRANT SELECT, DELETE ON palpate_queue._private_jobs TO palpate_worker;
GRANT UPDATE (attempts, last_error, locked_at, locked_by, payload, run_at, updated_at)
    ON palpate_queue._private_jobs TO palpate_worker;
GRANT SELECT, UPDATE (locked_at, locked_by) ON palpate_queue._private_job_queues TO palpate_worker;
GRANT SELECT ON palpate_queue._private_job_retirements TO palpate_worker;

-- Leases.
GRANT SELECT, INSERT, UPDATE, DELETE ON palpate_queue._private_workers TO palpate_worker;

-- The tables of the queue have row-level security without a policy: only their owner sees rows.
DROP POLICY IF EXISTS palpate_worker ON palpate_queue._private_tasks;
CREATE POLICY palpate_worker ON palpate_queue._private_tasks FOR SELECT TO palpate_worker USING (true);
DROP POLICY IF EXISTS palpate_worker ON palpate_queue._private_jobs;
CREATE POLICY palpate_worker ON palpate_queue._private_jobs TO palpate_worker USING (true);
DROP POLICY IF EXISTS palpate_worker ON palpate_queue._private_job_queues;
CREATE POLICY palpate_worker ON palpate_queue._private_job_queues TO palpate_worker USING (true);
