"""Links: bytes between this machine and vehicles, recorded, counted, and handed to the event loop in batches."""
