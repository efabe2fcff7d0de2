"""What a campaign does with one item: a vehicle, an upload, or a file of an archive."""
