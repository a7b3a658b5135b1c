"""Plan how a two-handed robot folds a cloth into any given shape (Arnold, Tanaka and Yamazaki, 2023)."""
