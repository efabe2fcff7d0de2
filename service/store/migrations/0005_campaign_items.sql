-- What a campaign goes through: one row a vehicle or a log, in the order in which they are begun.
CREATE TABLE campaign_items (
    job_id TEXT NOT NULL REFERENCES jobs (id),
    number INTEGER NOT NULL CHECK (number > 0),
    subject TEXT NOT NULL,
    outcome TEXT NOT NULL,
    body TEXT NOT NULL CHECK (json_valid(body)),
    PRIMARY KEY (job_id, number)
) STRICT;
CREATE INDEX campaign_items_by_outcome ON campaign_items (job_id, outcome, number);
