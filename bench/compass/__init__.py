"""Whether the stated uncertainty of a compass is true, by rate of turn and by noise."""
