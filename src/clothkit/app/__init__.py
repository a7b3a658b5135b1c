"""Commands that people run by hand, and the viewer; they use the artifacts that the pipeline made."""
