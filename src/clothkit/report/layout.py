"""Names of the tables' rows and columns, for those who make tables and those who print them."""

TASKS = ("1/0", "1/1", "1/2", "1/all", "2/0", "2/1", "2/all", "3/all")
"""Columns of tables 3, 4, 6 and 7: length / start."""

BY_LENGTH = ("1/all", "2/all", "3/all")
"""Those of every start; three manipulations have one start only."""

STATES = ("1", "2", "3", "all")
"""Columns of table 2: how many manipulations lie behind the state."""

LENGTHS = ("1", "2", "3")
"""Columns of table 5: how many manipulations were predicted, from every start."""

STATISTICS = ("mean", "std", "median")
NO_ACTION = "no action"
NO_ACTION_OCCLUDED = "no action, occluded"
RATIO = "mean / no action"

LOW, HIGH = "mean 95 % low", "mean 95 % high"
"""Statistics of tables 6 and 7: the ends of the bootstrap interval of a mean."""

LABELLED = "mean, labelled"
"""The statistic that takes outcome and goal as they are labelled, in place of the best of eight labellings."""
