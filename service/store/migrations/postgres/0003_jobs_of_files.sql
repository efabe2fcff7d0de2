-- As 0003_jobs_of_files.sql; PostgreSQL can drop NOT NULL.
ALTER TABLE jobs ALTER COLUMN vehicle_id DROP NOT NULL;

CREATE TABLE documents (
    job_id TEXT NOT NULL REFERENCES jobs (id),
    name TEXT NOT NULL,
    media_type TEXT NOT NULL,
    body BLOB NOT NULL,
    PRIMARY KEY (job_id, name)
) STRICT;
