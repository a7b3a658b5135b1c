"""One module per question: estimation, prediction, planning; each answers in tidy rows."""
