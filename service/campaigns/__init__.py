"""Campaigns: the same work on many vehicles, uploads, or files of an archive."""
