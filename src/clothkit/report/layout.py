"""Names of the tables' rows and columns, for the modules that make tables and those that print them."""

SPLITS = {"test": "Test set", "train": "Training set"}
"""Titles of the splits that evaluations use."""

CLOTH_LENGTHS = "lengths of the cloth's side"
"""Unit of errors."""

VOXEL_DIFFERENCE = "mean voxel value difference"
"""Unit of errors in voxels."""

TASKS = ("1/0", "1/1", "1/2", "1/all", "2/0", "2/1", "2/all", "3/all")
"""Columns of tables 3, 4, 6 and 7: length / start."""

BY_LENGTH = ("1/all", "2/all", "3/all")
"""The columns of TASKS with the mean over all starts; three manipulations have one start only."""

STATES = ("1", "2", "3", "all")
"""Columns of table 2: number of manipulations before the state."""

LENGTHS = ("1", "2", "3")
"""Columns of table 5: number of predicted manipulations, over all starts."""

HYPOTHESES = (
    *("split", "state", "states", "several", "probability", "error", "best"),
    *("probability_several", "error_several", "best_several"),
)
"""Columns of the table of what several hypotheses give."""

BY_CLOTH = ("measure", "system", "property", "class", "sequences", *LENGTHS)
"""Columns of the table of errors by cloth."""

STARTS = ("flat", "dragged", "crumpled")
"""How cloths lie at first of which named goals are made."""

GOALS = ("goal", "manipulations", "source", "cloths", *STARTS)
"""Columns of the tables of named goals."""

GOALS_SPREAD = tuple(f"{start}_std" for start in STARTS)
"""Further ones, which tables of older reports lack: the standard deviation over cloths, by start."""

PROBED = ("all", "start 0", "start 1", "start 2", "step 1", "step 2", "step 3")
"""Groups of probes: all, those of one manipulation by the state that they start from, those of each manipulation."""

TRUST = ("trust", "plans", "expected", "error", "trusted", "came_true", "inside")
"""Columns of the table of how far plans' expectations came true."""

OUTCOMES = ("source", "split", "system", "statistic", *TASKS)
COMPARISON = ("column", "sequences", "difference", "low", "high", "p")
COMPARISONS = ("split", "measure", "system", "against", *COMPARISON)

PLAN_LENGTH = (
    *("split", "system", "steps", "column", "tasks", "error", "error_low", "error_high", "used", "error_no_action"),
    *("difference", "difference_low", "difference_high", "p"),
)
"""Columns of the study of the number of manipulations that its table is made of."""

PLAN_WAYS = ("split", "measure", "column", "sequences", "own", "cut", "difference", "low", "high", "p")
"""Columns of the same study's table of plans that are cut."""

REACH = ("region", "size", "way", "tasks", "inside", "turned", "searched", "error", "error_inside", "error_free_inside")
"""Columns of the study of reach that its table is made of."""

STATISTICS = ("mean", "std", "median")
NO_ACTION = "no action"
NO_ACTION_OCCLUDED = "no action, occluded"
RATIO = "mean / no action"

LOW, HIGH = "mean 95 % low", "mean 95 % high"
"""Statistics of tables 6 and 7: the ends of the bootstrap interval of a mean."""

LABELLED = "mean, labelled"
"""The statistic of errors under the dataset's labels, in place of the best of eight labellings."""
