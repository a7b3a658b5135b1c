"""What people run by hand: commands on artifacts that the pipeline made."""
