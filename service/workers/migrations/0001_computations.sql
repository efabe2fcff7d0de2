-- What is computed for somebody who waits. A row whose `wanted` has passed is of nobody any more.
CREATE TABLE computations (
    id TEXT PRIMARY KEY,
    task TEXT NOT NULL,
    body TEXT NOT NULL,
    wanted TIMESTAMPTZ NOT NULL,
    starts BIGINT NOT NULL DEFAULT 0,
    worker TEXT,
    said TEXT,
    result TEXT
);
