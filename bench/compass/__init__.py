"""Whether the stated uncertainty of a compass is true, over how fast it is turned and how noisy it is."""
