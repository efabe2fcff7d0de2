-- What is known of every unit beside its jobs: what people call it, what was measured of its sensors, and what its
-- last preflight said. A unit is named as its vehicle is: `uid-` and its hardware id, or the place where it was heard.
CREATE TABLE fleet_units (
    unit_id TEXT PRIMARY KEY,
    name TEXT NOT NULL,
    tags TEXT NOT NULL,
    autopilot TEXT NOT NULL,
    firmware TEXT NOT NULL,
    seen_at REAL NOT NULL
) STRICT;

-- One sensor as a job, or a preflight, measured it once. Rows of a job go if the job is taken back.
CREATE TABLE sensor_records (
    source_id TEXT NOT NULL,
    sensor TEXT NOT NULL,
    instance INTEGER NOT NULL CHECK (instance >= 0),
    source TEXT NOT NULL CHECK (source IN ('job', 'preflight')),
    unit_id TEXT NOT NULL,
    at REAL NOT NULL,
    body TEXT NOT NULL,
    PRIMARY KEY (source_id, sensor, instance)
) STRICT;
CREATE INDEX sensor_records_by_unit ON sensor_records (unit_id, at);

-- Jobs whose measurements were taken, so that a start takes up what a crash left out.
CREATE TABLE fleet_sources (
    source_id TEXT PRIMARY KEY
) STRICT;

CREATE TABLE fleet_preflights (
    unit_id TEXT PRIMARY KEY,
    at REAL NOT NULL,
    verdict TEXT NOT NULL,
    body TEXT NOT NULL
) STRICT;
