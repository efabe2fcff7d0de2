-- Who owns what. The token of a lease is never given out twice: whoever lost one cannot be taken for its new owner.
CREATE SEQUENCE lease_tokens;
CREATE TABLE leases (
    subject TEXT PRIMARY KEY,
    owner TEXT NOT NULL,
    name TEXT NOT NULL,
    url TEXT,
    token BIGINT NOT NULL,
    expires TIMESTAMPTZ NOT NULL
);
