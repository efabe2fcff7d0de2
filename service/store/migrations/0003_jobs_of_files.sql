-- Jobs that compute something of uploads have no vehicle. SQLite cannot drop NOT NULL: the table is made once more, while
-- foreign keys are not enforced.
CREATE TABLE jobs_of_all_kinds (
    id TEXT PRIMARY KEY,
    vehicle_id TEXT,
    kind TEXT NOT NULL,
    state TEXT NOT NULL CHECK (state IN (
        'queued', 'running', 'waiting_for_operator', 'fitting', 'review', 'applying', 'waiting_for_reboot',
        'verifying', 'succeeded', 'rolling_back', 'reverted', 'in_doubt', 'failed', 'cancelled', 'interrupted')),
    created_at REAL NOT NULL,
    updated_at REAL NOT NULL,
    body TEXT NOT NULL CHECK (json_valid(body))
) STRICT;
INSERT INTO jobs_of_all_kinds SELECT * FROM jobs ORDER BY rowid;
DROP TABLE jobs;
ALTER TABLE jobs_of_all_kinds RENAME TO jobs;
CREATE INDEX jobs_by_vehicle ON jobs (vehicle_id, state);

-- What a job has made beside its results: the report of a diagnosis.
CREATE TABLE documents (
    job_id TEXT NOT NULL REFERENCES jobs (id),
    name TEXT NOT NULL,
    media_type TEXT NOT NULL,
    body BLOB NOT NULL,
    PRIMARY KEY (job_id, name)
) STRICT;
