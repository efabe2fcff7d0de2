"""The calibration in force on a vehicle: what it is made of, what a plan rests on, how to take it out."""
