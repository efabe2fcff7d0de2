"""How often the intervals of a drift hold the truth, and how often a healthy sensor is called odd."""
