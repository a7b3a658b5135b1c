"""The report's sections on planning: sessions, cameras, named goals, the number of manipulations, and reach."""

from clothkit.report import captions, selections, texts
from clothkit.report.entries import Figure, Section, Table, Text
from clothkit.report.layout import (
    CLOTH_LENGTHS,
    COMPARISON,
    COMPARISONS,
    GOALS,
    OUTCOMES,
    PLAN_LENGTH,
    PLAN_WAYS,
    REACH,
    VOXEL_DIFFERENCE,
)

BY_SYSTEM = ("split", "system", "statistic")
"""Keys of the tables with the paper's figures beside ours."""

SESSIONS = Section(
    "planning",
    "Planning",
    (
        Figure("sessions_1", "Figure 12, one step", f"Planning in one step. {captions.SESSIONS}"),
        Figure("sessions_2", "Figure 12, two steps", f"Planning in two steps. {captions.SESSIONS}"),
        Figure("sessions_3", "Figure 12, three steps", f"Planning in three steps. {captions.SESSIONS}"),
        Table(
            "table_6",
            "Table 6: planning, in meshes",
            OUTCOMES,
            (
                texts.with_paper(captions.LABELLED, captions.LABELLED_PAPER),
                captions.INTERVALS,
                texts.unequal_budgets,
            ),
            selections.mark_systems,
            keys=BY_SYSTEM,
            unit=CLOTH_LENGTHS,
            noted=True,
        ),
        Figure("scatter", "Figure 11", captions.SCATTER),
        Table(
            "table_7",
            "Table 7: planning, in voxels",
            OUTCOMES,
            (captions.PLANNING_VOXELS, texts.viewport_of_planning, texts.unequal_budgets),
            selections.mark_systems,
            keys=BY_SYSTEM,
            unit=VOXEL_DIFFERENCE,
            noted=texts.is_beside_paper,
        ),
        Table(
            "table_7_025",
            "Table 7 for a viewport of height 0.25",
            OUTCOMES,
            (texts.with_paper(captions.TALL, captions.TALL_PAPER), texts.unequal_budgets),
            selections.mark_systems,
            keys=BY_SYSTEM,
            unit=VOXEL_DIFFERENCE,
            noted=texts.is_beside_paper,
        ),
        Table(
            "budgets",
            "Budgets",
            (),
            (texts.with_paper(captions.BUDGETS, captions.BUDGETS_PAPER),),
            selections.budgets,
            file="budgets.csv",
        ),
        Table(
            "planning_comparisons",
            "Planners compared",
            COMPARISONS,
            (captions.PLANNING_COMPARISONS, texts.unequal_budgets),
            selections.comparisons_of_planners,
        ),
        Table(
            "failures",
            "Failures",
            ("split", "system", "length", "tasks"),
            (captions.FAILURES,),
            selections.of_test_set,
        ),
        Table(
            "largest",
            "Largest errors",
            ("sequence", "start", "length", "error", "diagnosis"),
            (captions.LARGEST,),
        ),
        Figure("largest", "Largest errors", captions.LARGEST_PICTURED),
    ),
)

CAMERA = Section(
    "camera",
    "Depth camera",
    (
        Text(captions.CAMERA),
        Table(
            "camera_estimation",
            "Camera: observation and estimation",
            ("condition", "tilt", "noise", "states"),
            (captions.CAMERA_ESTIMATION,),
        ),
        Figure("camera", "Depth cameras", captions.CAMERA_PICTURED),
        Table(
            "camera_planning",
            "Camera: planning",
            ("condition", "tilt", "noise", "tasks"),
            (captions.CAMERA_PLANNING,),
        ),
        Table(
            "camera_comparisons",
            "Camera: conditions compared",
            ("condition", *COMPARISON),
            (captions.CAMERA_COMPARISONS,),
            selections.comparisons,
        ),
    ),
    needs=("camera_estimation", "camera_planning", "camera_comparisons"),
)

NAMED_GOALS = Section(
    "goals",
    "Named goals",
    (
        Text(captions.GOALS),
        Figure("goals", "Named goals", captions.GOALS_PICTURED),
        Table("goals", "Named goals: errors", GOALS, (captions.GOALS_ERROR,), unit=CLOTH_LENGTHS),
        Table("goals_softgym", "Named goals: SoftGym's measure", GOALS, (captions.GOALS_SOFTGYM,), unit=CLOTH_LENGTHS),
        Table("goals_iou", "Named goals: silhouettes", GOALS, (captions.GOALS_IOU,)),
    ),
    needs=("goals",),
)

LENGTHS_OF_PLANS = Section(
    "length",
    "Number of manipulations",
    (
        Text(captions.PLAN_LENGTH),
        Figure("plan_length", "Error by manipulations", captions.PLAN_LENGTH_PICTURED, file="studies/plan_length.png"),
        Table(
            "plan_length_summary",
            "Number of manipulations: chosen and told",
            PLAN_LENGTH,
            (captions.PLAN_LENGTH_TABLE,),
            selections.plan_length,
            file="studies/plan_length_summary.csv",
        ),
        Table(
            "plan_length_margins",
            "Number of manipulations: the margin",
            ("margin", "tasks", "error", "used", "difference", "standard_error", "chosen"),
            (captions.MARGINS,),
            selections.margins,
            file="studies/plan_length_margins.csv",
        ),
        Table(
            "plan_length_ways_summary",
            "Number of manipulations: searched for or cut",
            PLAN_WAYS,
            (captions.PLAN_WAYS,),
            selections.plan_ways,
            file="studies/plan_length_ways_summary.csv",
        ),
    ),
    needs=("plan_length_summary",),
)

WITHIN_REACH = Section(
    "reach",
    "Reach",
    (
        Text(captions.REACH),
        Figure("reach", "Plans within reach", captions.REACH_PICTURED, file="studies/reach.png"),
        Table(
            "reach_summary",
            "Plans within reach",
            REACH,
            (captions.REACH_TABLE,),
            selections.reach,
            file="studies/reach_summary.csv",
        ),
    ),
    needs=("reach_summary",),
)
