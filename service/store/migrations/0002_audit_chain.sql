-- Every row of the audit trail covers all rows before it. Rows from before this migration have no digest of their own;
-- the first row with one covers them too.
ALTER TABLE audit ADD COLUMN sha256 TEXT CHECK (sha256 IS NULL OR length(sha256) = 64);
