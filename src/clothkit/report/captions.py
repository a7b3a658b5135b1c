"""Texts above the report's tables and below its figures, in Markdown; the same on both pages.

Texts that depend on a report's settings or figures are in `said.py`.
"""

INTRO = (
    "Errors are mean distances between vertices in lengths of the cloth's side, the smallest over the cloth's "
    "eight equivalent labellings; outcomes and *no action* (start against goal) are moved onto the goal first, "
    "estimates and predictions are not. Columns: manipulations / state that they start from. *main* sees voxels "
    "only; *a1* predicts, and *b1* plans, from true meshes; *b2* plans with one net, *b3* without the uncertainty "
    "term, *b4* and *b5* in voxels, with two nets and with one. Pictured are the first test sequences, not chosen "
    "ones, but for the largest errors and the median cases.\n"
)
CANONICAL = (
    "The nets that predict meshes see each cloth in one canonical description, whatever its direction and labels"
)
VOXELS_CANONICAL = "those of the voxel baseline (*a2*, *b4*, *b5*) see voxels in one of eight, likewise"
VOXELS_AS_THEY_ARE = "those of the voxel baseline (*a2*, *b4*, *b5*) see voxels as they are, as the paper's do"
MEMORY = (
    "Section 5.1 hands a memory trace on from each plan of a session to the next. A canonical net describes every "
    "cloth that is observed in a new frame, in which the old trace means nothing: there it is dropped after each "
    "observation, so that sessions of mesh systems do without this mechanism of the paper's. "
)
MEMORY_STUDY = (
    "[A study](studies/memory.csv) on {sequences} validation sequences measured what it is worth: with the trace "
    "carried on into the new frame, the error of predictions changes by {low:+.4f} to {high:+.4f}, depending on the "
    "task (above zero, the trace does harm; p at most {p:.2g}).\n"
)
MEMORY_UNKNOWN = "What it is worth was not measured for this report.\n"
MISSING = "Not measured in this report.\n"
PAPER = (
    "The paper's figures are from another simulator, 3,493 training sequences, and 100 test and 100 training sequences "
    "in each table.\n"
)
UNCERTAINTY = (
    "Median over meshes of the mean of abs(error) / σ; 0.798 is ideal, less says that σ is too large. Columns: "
    "estimates, then predictions after one, two and three manipulations; the paper tells those of the test set.\n"
)

SESSIONS = (
    "Above the recorded sequence and its goal (light blue), which is all that the planner is given of it; at the left "
    "what happened, the outcome in light blue; between, plan by plan, the estimate (E) with grasp candidates (lilac "
    "circles) and the predictions (P, σ lilac); at the right the predicted outcome, refined. The first test sequences, "
    "and the task of median error. Paths that leave a picture end in an arrow at its border."
)
VOXELS = (
    "The same predictions in voxels: mean absolute difference of voxel values. *a2* is the paper's voxel baseline, "
    "which sees, and predicts, voxels. Meshes become voxels by eq. (16), and their truth is unoccluded, a vertex per "
    "grid point. *a2* predicts what a camera above sees, and its truth is that: occluded, at twice the mesh's "
    "resolution; so is its *no action*. *main_occluded* are *main*'s predictions in that format, as the share of "
    "meshes drawn from them in which a camera sees a voxel occupied: those two can be held against each other.\n"
)
COMPARISONS = (
    "The two on the same tasks: mean difference (system minus the one it is held against: below zero the first is "
    "better), its 95 % bootstrap interval, and p of a two-sided paired sign-flip test, both over sequences; neither "
    "is told of fewer than ten.\n"
)
POSITION = (
    "The predicted shift of the cloth's centre, by the number of manipulations, from every start; *no action* "
    "predicts no shift.\n"
)
_INTERVALS = (
    "the ends of a bootstrap interval of our mean, drawn by sequences, since tasks of one share its states; none is "
    "told of fewer than ten sequences.\n"
)
LABELLED = (
    "*mean, labelled* takes outcome and goal as the dataset labels them, and not the best of eight labellings; the "
    'paper\'s figures are distances "for each mesh vertex", and it names no choice of labelling.\n'
)
LABELLED_SHORT = (
    "Errors are those of the best of eight labellings; *labelled* ones take outcome and goal as the dataset labels "
    "them. The paper names no choice of labelling.\n"
)
INTERVALS = f"*mean 95 % low* and *high*, or *95 % of mean*, are {_INTERVALS}"
TALL = (
    "The table above for a viewport of height 0.25, in which voxels are four times finer in z than in x and y, as the "
    "paper's text says; the paper's figures are the same.{}\n"
)
TALL_A2 = (
    " *a2* predicts voxels of the usual viewport: the larger value of every two that lie one above the other is taken "
    "for the voxel that holds them, and what lies above that viewport is taken for empty."
)
BUDGETS = (
    "What plans were made with, and how long the nets learned: *nets* in a plan (two were trained, and systems of one "
    "plan with the better); *parameters* of each; *training_cpu_minutes* of both, in the stages' last runs on this "
    "machine (a training that was interrupted counts from where it went on); *evaluations* of the loss with its "
    "gradient in the search for a plan of 1, 2 and 3 manipulations, which are strains times iterations; one of the "
    "voxel nets costs many times as much as one of the mesh nets. The paper's: its settings, with the parameters that "
    "they have here.\n"
)
PLANNING_VOXELS = (
    "The same outcomes and goals in voxels: mean absolute difference of voxel values, both sides free of noise and "
    "unoccluded, a vertex per grid point.\n"
)
PLANNING_COMPARISONS = (
    "Two planners on the same tasks: mean difference (system minus the one it is held against: below zero the first is "
    "better), its 95 % bootstrap interval, and p of a two-sided paired sign-flip test, both over sequences; neither "
    "is told of fewer than ten, and p is not adjusted for the number of comparisons. Shown are those of the test set "
    "by length; the CSV has every start, and the training set.\n"
)
SPEED = (
    "Seconds of search over the number of plans, by system and plan length; *estimate*: seconds per estimate of a "
    "mesh, refined but for *unrefined* (the paper's: 3.7 ms for VtM, 0.57 s for the refinement). Ours with the sizes "
    "of [params.yaml](params.yaml), the paper's with those of its table 1. Searches run many at a time. A dash: none, "
    "or the stage's results were restored and its times are not known.\n"
)
TIMINGS = (
    "Of the stages' last runs on this machine, with the time of all their processes and the memory of the largest; a "
    "stage whose results were restored has no row.\n"
)
STATES = "By how many manipulations lie behind the state; *no action* takes the state before the last one for it.\n"
FAILURES = (
    "Of each session's first plan, and of what came of the session, test set. *search_failure*: share of plans that "
    "the nets rate worse than the recorded manipulations, which the search missed; *model_failure*: share that they "
    "rate no worse, yet whose outcome is more than 0.05 off; *layers_reversed*: share whose outcome has the goal's "
    "folds, but more than a quarter of its layers in another order (folding twice, first over the other axis, makes "
    "it a half); *grasp_offered*: share of starts with a grasp candidate at each recorded grasp point; *nulls_fired*: "
    "manipulations per session that the planner cancelled because it expected their plan to end no nearer to the "
    "goal, *nulls_helped*: of those in a session's last step, the share that would have led away from it, as a "
    "simulation of what was cancelled tells; *expected*, *error*: mean error that the nets expect, and that came; "
    "*error_estimate_good*, *error_estimate_bad*: mean error of tasks whose first estimate is within 0.05 of the "
    "truth, and of the others. The CSV has the training set, too.\n"
)
LARGEST = (
    "The test tasks with the largest errors, and why, in the words of the paper's section 6.4; the first that holds: "
    "a recorded grasp point had no candidate nearby (*grasp point not offered*); the first estimate was more than "
    "0.05 off (*estimate wrong*); more than a quarter of its layers lie in another order than the truth's "
    "(*estimate's layers reversed*), or of the final outcome's in another order than the goal's (*layers reversed*); "
    "the nets rate the recorded manipulations better than the plan (*search failure*); they expected an error of at "
    "most 0.05 (*model failure*); none of these (*open*): they knew that the plan is not good, and think no better of "
    "the recorded manipulations. All but *error* and *layers_reversed* are of the first plan: what went wrong later "
    "is not told.\n"
)
CAMERA = (
    "Test cloths before a simulated depth camera (section 6.5), tilted from straight down by so many degrees, with "
    "multiples of the noise and holes of a first-generation Kinect. Clouds take the way of a user's: "
    "the table is found, the cloth cut out, voxels centred where the cloth was seen; *voxels* is the condition of all "
    "other tables, those of the true mesh, free of noise.\n"
)
CAMERA_ESTIMATION = (
    "Means over states after one, two and three manipulations. *seen*: share of states that some picture "
    "shows; *voxel_error*: mean difference to the noise-free voxels; *centre_error*: how far the observed centre "
    "is off, and *estimate*: error of the refined estimate, in lengths of the cloth's side; *iou*: of what the cloud "
    "covers and the true silhouette.\n"
)
CAMERA_PLANNING = (
    "The same tasks under every condition, planned by *main*; estimates, and where hands grasp, are from the camera's "
    "clouds. Columns 1, 2, 3: mean error of outcomes by manipulations; *iou*: of outcomes' and goals' true "
    "silhouettes, *iou_seen*: of goals' and of what the camera sees of outcomes.\n"
)
CAMERA_COMPARISONS = (
    "Each condition against *voxels* on the same tasks: mean difference of errors (above zero the camera costs "
    "something), its 95 % bootstrap interval, and p of a two-sided paired sign-flip test, both over sequences; "
    "neither is told of fewer than ten.\n"
)
SYSTEMS = {
    "main": "sees voxels only; two mesh nets",
    "a1": "main, from true meshes",
    "a2": "two voxel nets",
    "main_occluded": "main's predictions, as a camera above would see them",
    "b1": "main, from true meshes",
    "b2": "main with one net",
    "b3": "main without the uncertainty term",
    "b4": "two voxel nets",
    "b5": "one voxel net",
    "unrefined": "main without refinement of its estimates",
    "no action": "start against goal",
    "no action, occluded": "start against goal, as a camera above sees them",
    "pmr": "VtM's probabilistic mesh, its means",
    "dmr": "the refined mesh",
}
"""Meanings of the names of systems and of kinds of estimates."""

CAPTIONS_FILE = "captions.json"
"""File beside a report's figures with the captions that they had when they were drawn."""

CAPTIONS = {
    "sequences": "Simulated test sequences: states from above, manipulations dotted (red and green: the two hands); "
    "blue and orange are the cloth's two sides.",
    "estimates": "Estimates of test sequences after one, two and three manipulations: truth, voxels, VtM's mean with "
    "its σ in lilac, and the refined mesh.",
    "predictions": "Predictions from an estimate of the first state (E) beside what was recorded (R). Lilac is σ, the "
    "yellow arrow in a corner the predicted shift of the cloth's centre, to scale.",
    "sessions_1": f"Planning in one step. {SESSIONS}",
    "sessions_2": f"Planning in two steps. {SESSIONS}",
    "sessions_3": f"Planning in three steps. {SESSIONS}",
    "calibration": "Test set: the share of coordinates whose error is below z σ, against the share of a normal "
    "distribution there; dots are at z = 1. Above the dashed diagonal σ is larger than the errors warrant, below it "
    "smaller. Estimates by the manipulations that lie behind the state; predictions from estimates, by the "
    "manipulations predicted, from every start.",
    "scatter": "Planning error against prediction error, a dot per test task. Predictions start from what the planner "
    "starts from: estimates beside main, true meshes (a1) beside b1.",
    "largest": "The largest errors, in the table's order: start with the recorded manipulation, and goal; then, plan "
    "by plan, the estimate with grasp candidates (lilac circles) and the plan's first manipulation, the outcome "
    "predicted for the whole plan (σ lilac), and what its execution led to, the final outcome on light blue. Numbers "
    "are how far the first estimate is off, how far from the goal the nets expect the first plan to end, and how far "
    "from it the cloth was in the end.",
    "camera": "Test states before cameras: the middle of the picture by height above "
    "the table, the voxels that come of it (the scales below are those of all pictures), and the refined estimate. On "
    "the left the truth, its voxels free of noise, and their estimate.",
    "meshes": "One state of the first test sequence, as a mesh and as the probabilistic mesh that VtM makes of its "
    "voxels: from above (the grid is printed on the picture; lilac is σ), and each component over the cloth, u to the "
    "right, v upwards. Light is more: x and y over the viewport, z over the mesh's own heights, σ up to the number "
    "above it.",
    "voxels": "The same state in voxels, without noise and unoccluded: the share of occupied voxels along each line of "
    "sight, darker is more. z is stretched as the viewport's resolution stretches it.",
    "trajectories": "From grasp points g and displacement d to release points r: two hands' are mirrored at the line "
    "m, which stands across d in p (eq. 1); a single hand moves by d. Grey: the silhouette. What leaves the picture "
    "ends in an arrow at its border, in every figure.",
    "equivalents": "One shape as eight meshes, with the geodesic coordinates of its corners; the colours are those of "
    "geodesic coordinates, too.",
    "curves": "Validation errors during training, with their values where the score was best (dots). Tasks: "
    "manipulations / state that they start from; states: manipulations that lie behind them.",
}
