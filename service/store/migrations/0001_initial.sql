-- Durable state of one data directory. Samples are not here: they lie in files, and `segments` and `recordings`
-- hold where, with their sha256. Times are wall-clock seconds since 1970 (UTC).

CREATE TABLE jobs (
    id TEXT PRIMARY KEY,
    vehicle_id TEXT NOT NULL,
    kind TEXT NOT NULL,
    state TEXT NOT NULL CHECK (state IN (
        'queued', 'running', 'waiting_for_operator', 'fitting', 'review', 'applying', 'waiting_for_reboot',
        'verifying', 'succeeded', 'rolling_back', 'reverted', 'in_doubt', 'failed', 'cancelled', 'interrupted')),
    created_at REAL NOT NULL,
    updated_at REAL NOT NULL,
    body TEXT NOT NULL CHECK (json_valid(body))
) STRICT;
CREATE INDEX jobs_by_vehicle ON jobs (vehicle_id, state);

CREATE TABLE job_events (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    job_id TEXT NOT NULL REFERENCES jobs (id),
    sequence INTEGER NOT NULL CHECK (sequence > 0),
    at REAL NOT NULL,
    kind TEXT NOT NULL,
    data TEXT NOT NULL CHECK (json_valid(data)),
    UNIQUE (job_id, sequence)
) STRICT;

-- What was about to be done to a vehicle, and what was seen to be done; the ground truth of recovery.
CREATE TABLE journal (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    job_id TEXT NOT NULL REFERENCES jobs (id),
    at REAL NOT NULL,
    step TEXT NOT NULL,
    data TEXT NOT NULL CHECK (json_valid(data))
) STRICT;
CREATE INDEX journal_by_job ON journal (job_id, id);
CREATE TRIGGER journal_is_append_only BEFORE UPDATE ON journal
BEGIN SELECT RAISE(ABORT, 'the journal is append-only'); END;

CREATE TABLE snapshots (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    job_id TEXT NOT NULL REFERENCES jobs (id),
    at REAL NOT NULL,
    purpose TEXT NOT NULL CHECK (purpose IN ('composed_on', 'before_write')),
    sha256 TEXT NOT NULL CHECK (length(sha256) = 64),
    body TEXT NOT NULL CHECK (json_valid(body))
) STRICT;
CREATE INDEX snapshots_by_job ON snapshots (job_id, purpose, id);

CREATE TABLE plans (
    sha256 TEXT NOT NULL CHECK (length(sha256) = 64),
    job_id TEXT NOT NULL REFERENCES jobs (id),
    at REAL NOT NULL,
    body TEXT NOT NULL CHECK (json_valid(body)),
    PRIMARY KEY (job_id, sha256)
) STRICT;

-- Spans of telemetry logs. An open segment (its end is not known yet) has neither end nor digest.
CREATE TABLE segments (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    job_id TEXT NOT NULL REFERENCES jobs (id),
    purpose TEXT NOT NULL CHECK (purpose IN ('capture', 'before', 'after')),
    path TEXT NOT NULL,
    start_byte INTEGER NOT NULL CHECK (start_byte >= 0),
    end_byte INTEGER CHECK (end_byte >= start_byte),
    sha256 TEXT CHECK (length(sha256) = 64),
    CHECK ((end_byte IS NULL) = (sha256 IS NULL))
) STRICT;
CREATE INDEX segments_by_job ON segments (job_id, purpose, id);

CREATE TABLE recordings (
    id TEXT PRIMARY KEY,
    at REAL NOT NULL,
    name TEXT NOT NULL,
    path TEXT NOT NULL,
    size INTEGER NOT NULL CHECK (size >= 0),
    sha256 TEXT NOT NULL CHECK (length(sha256) = 64),
    body TEXT NOT NULL CHECK (json_valid(body))
) STRICT;

CREATE TABLE links (
    id TEXT PRIMARY KEY,
    url TEXT NOT NULL,
    at REAL NOT NULL
) STRICT;

-- The newest accepted signature time stamp of a stream (48 bits, 10 us units); it never goes back.
CREATE TABLE signing_timestamps (
    stream TEXT PRIMARY KEY,
    timestamp INTEGER NOT NULL CHECK (timestamp >= 0)
) STRICT;

CREATE TABLE idempotency_keys (
    key TEXT PRIMARY KEY,
    request_sha256 TEXT NOT NULL CHECK (length(request_sha256) = 64),
    job_id TEXT NOT NULL,
    at REAL NOT NULL
) STRICT;

CREATE TABLE audit (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    at REAL NOT NULL,
    actor TEXT NOT NULL,
    action TEXT NOT NULL,
    subject TEXT NOT NULL,
    detail TEXT NOT NULL CHECK (json_valid(detail))
) STRICT;
CREATE TRIGGER audit_is_append_only BEFORE UPDATE ON audit
BEGIN SELECT RAISE(ABORT, 'the audit trail is append-only'); END;
CREATE TRIGGER audit_is_kept BEFORE DELETE ON audit
BEGIN SELECT RAISE(ABORT, 'the audit trail is append-only'); END;
