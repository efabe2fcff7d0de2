-- What 0001_initial.sql says in words of SQLite that `service/store/postgres.py` does not translate: triggers.
CREATE FUNCTION json_valid(body TEXT) RETURNS BOOLEAN LANGUAGE plpgsql IMMUTABLE AS
$$ BEGIN PERFORM body::json; RETURN TRUE; EXCEPTION WHEN invalid_text_representation THEN RETURN FALSE; END $$;

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

CREATE TABLE journal (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    job_id TEXT NOT NULL REFERENCES jobs (id),
    at REAL NOT NULL,
    step TEXT NOT NULL,
    data TEXT NOT NULL CHECK (json_valid(data))
) STRICT;
CREATE INDEX journal_by_job ON journal (job_id, id);

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

CREATE FUNCTION refuse_change() RETURNS trigger LANGUAGE plpgsql AS
$$ BEGIN RAISE EXCEPTION 'the % is append-only', TG_ARGV[0]; END $$;
CREATE TRIGGER journal_is_append_only BEFORE UPDATE ON journal
FOR EACH ROW EXECUTE FUNCTION refuse_change('journal');
CREATE TRIGGER audit_is_append_only BEFORE UPDATE ON audit
FOR EACH ROW EXECUTE FUNCTION refuse_change('audit trail');
CREATE TRIGGER audit_is_kept BEFORE DELETE ON audit
FOR EACH ROW EXECUTE FUNCTION refuse_change('audit trail');

-- The id that was given out last, also if its row has gone: a trail that was cut off at its end is noticed.
CREATE TABLE audit_end (newest INTEGER NOT NULL);
INSERT INTO audit_end VALUES (0);
CREATE FUNCTION note_audit_end() RETURNS trigger LANGUAGE plpgsql AS
$$ BEGIN UPDATE audit_end SET newest = greatest(newest, NEW.id); RETURN NULL; END $$;
CREATE TRIGGER audit_has_an_end AFTER INSERT ON audit FOR EACH ROW EXECUTE FUNCTION note_audit_end();
