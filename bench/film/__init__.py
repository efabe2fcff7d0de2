"""Pictures of the panel in a real browser: every room, and whole calibrations as contact sheets."""
