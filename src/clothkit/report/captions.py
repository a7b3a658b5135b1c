"""Texts above the report's tables and below its figures, in Markdown; the same on both pages.

Texts that depend on a report's settings or figures are in `texts.py`.
"""

INTRO = (
    "Errors are mean distances between vertices, in lengths of the cloth's side. Each is the smallest over "
    "{labellings}. Outcomes and *no action* (the start compared with the goal) are translated onto the goal first; "
    "estimates and predictions are not. Columns: number of manipulations / state from which they start. {systems} The "
    "pictures show the first test sequences, which were not selected by their results, except for the largest errors "
    "and the median cases.\n"
)
LABELLINGS = "the cloth's eight equivalent labellings"
LABELLINGS_VARIED = "the cloth's equivalent labellings (eight of a square, four of a rectangle)"
INTRODUCED = {
    ("main",): "*main* observes voxels only.",
    ("a1", "b1"): "*a1* predicts and *b1* plans from true meshes.",
    ("b2", "b3"): "*b2* plans with one net, and *b3* without the uncertainty term.",
    ("b3",): "*b3* plans without the uncertainty term.",
    ("b4", "b5"): "*b4* and *b5* plan in voxels, with an ensemble and with one net.",
}
"""Sentences about systems; each stands where all of them are in the report, and none of them in a sentence before."""
CANONICAL = (
    "The input of the nets that predict meshes is one canonical description of each cloth, which does not depend on "
    "the cloth's direction and labels"
)
VOXELS_CANONICAL = "the input of the voxel baseline's nets (*a2*, *b4*, *b5*) is likewise one of eight equivalent grids"
VOXELS_AS_THEY_ARE = (
    "the input of the voxel baseline's nets (*a2*, *b4*, *b5*) is the observed voxels, unchanged, as in the paper"
)
MEMORY = (
    "In section 5.1 of the paper, each plan of a session passes its memory trace on to the next plan. A canonical net "
    "describes each newly observed cloth in a new frame, in which the old trace has no meaning. The trace is therefore "
    "dropped after each observation, and sessions of mesh systems do not use this mechanism of the paper. "
)
MEMORY_STUDY = (
    "[A study](studies/memory.csv) on {sequences} validation sequences measured the effect: with the trace carried on "
    "into the new frame, the error of predictions changes by {low:+.4f} to {high:+.4f}, depending on the task (above "
    "zero, the trace does harm; p at most {p:.2g}).\n"
)
MEMORY_UNKNOWN = "The effect was not measured for this report.\n"
MISSING = "Not measured in this report.\n"
PAPER = (
    "The paper's values are from another simulator and from 3,493 training sequences; each of its tables has 100 test "
    "and 100 training sequences.\n"
)
UNCERTAINTY = (
    "Median over meshes of the mean of abs(error) / σ. The ideal is 0.798; a smaller value means that σ is too large. "
    "Columns: estimates, then predictions after one, two and three manipulations.\n"
)
UNCERTAINTY_STATES = (
    "*estimate* is over all states; *estimate 1*, *2* and *3* are those after one, two and three manipulations.\n"
)
UNCERTAINTY_PAPER = "The paper gives values for the test set only.\n"

VOXELS = (
    "The same predictions in voxels: mean absolute difference of voxel values. *a2* is the paper's voxel baseline: its "
    "input and its predictions are voxels. Predicted meshes become voxels by eq. (16). They are compared with the true "
    "mesh's voxels, without occlusion, from one vertex per grid point. *a2* predicts what a camera above the cloth "
    "sees, so it is compared with occluded voxels from a mesh of twice the resolution, and so is its *no action*. "
    "*main_occluded* converts *main*'s predictions to that format: meshes are drawn from the prediction, and a voxel's "
    "value is the share of them in which a camera sees the voxel as occupied. Compare *main_occluded* with *a2*.\n"
)
COMPARISONS = (
    "Both predictors on the same tasks: mean difference (system minus against; below zero, the system is better), its "
    "95 % bootstrap interval, and p of a two-sided paired sign-flip test, both over sequences. Interval and p are not "
    "given for fewer than ten sequences.\n"
)
POSITION = (
    "Error of the predicted shift of the cloth's centre, by number of manipulations, over all starts. *no action* "
    "predicts no shift.\n"
)
LABELLED = (
    "*mean, labelled* compares outcome and goal vertex by vertex in the dataset's labels, instead of in the best of "
    "eight labellings.\n"
)
LABELLED_PAPER = 'The paper\'s errors are distances "for each mesh vertex"; it does not say which labelling it uses.\n'
LABELLED_SHORT = (
    "Errors are those in the best of eight labellings; *labelled* ones compare outcome and goal in the dataset's "
    "labels.\n"
)
LABELLED_SHORT_PAPER = "The paper does not say which labelling it uses.\n"
INTERVALS = (
    "*mean 95 % low* and *high*, or *95 % of mean*, are the ends of a bootstrap interval of our mean. It resamples "
    "sequences, because the tasks of a sequence share states. It is not given for fewer than ten sequences.\n"
)
TALL = (
    "The table above for a viewport of height 0.25, whose voxels are four times finer in z than in x and y, as the "
    "paper's text says.\n"
)
TALL_PAPER = "The paper's values are the same as above.\n"
TALL_A2 = (
    "*a2* predicts voxels of the usual viewport. Each voxel of this table takes the larger of the two values that lie "
    "in it, one above the other; voxels above the usual viewport count as empty.\n"
)
BUDGETS = (
    "The budgets for planning and training. *nets*: nets used in a plan: an ensemble, or for systems with one net the "
    "best of it. *parameters_millions*: of each net. *training_cpu_minutes*: of all nets of the ensemble, in the "
    "stages' last runs on this machine; for a training that was interrupted, only the time after it was resumed. "
    "*strains*: plans that an iteration changes. *evaluations*: how often the search for a plan of 1, 2 or 3 "
    "manipulations evaluates the loss, with or without its gradient. One evaluation of a voxel net costs many times as "
    "much as one of a mesh net.\n"
)
BUDGETS_PAPER = (
    "The paper's rows have the paper's settings; their numbers of parameters are those of our implementation.\n"
)
PLANNING_VOXELS = (
    "The same outcomes and goals in voxels: mean absolute difference of voxel values. Both are without noise and "
    "occlusion, from one vertex per grid point.\n"
)
PLANNING_COMPARISONS = (
    "Two planners on the same tasks: mean difference (system minus against; below zero, the system is better), its "
    "95 % bootstrap interval, and p of a two-sided paired sign-flip test, both over sequences. Interval and p are not "
    "given for fewer than ten sequences, and p is not adjusted for the number of comparisons. The table shows the test "
    "set by length; the CSV also has every start and the training set.\n"
)
SPEED = (
    "Seconds of search per plan, by system and plan length. *estimate*: seconds per estimate of a mesh, including its "
    "refinement except for *unrefined*. Sizes are those of [params.yaml](params.yaml). Many searches run at the same "
    "time. A dash: the system has none, or the stage's results were restored and its times are not known.\n"
)
SPEED_PAPER = (
    "The paper's sizes are those of its table 1; its estimates take 3.7 ms for VtM and 0.57 s for the refinement.\n"
)
TIMINGS = (
    "Of the stages' last runs on this machine: CPU time of all processes, and memory of the largest process. A stage "
    "whose results were restored has no row.\n"
)
STAGES = "[Seconds and memory of every stage](timings.csv), of the stages' last runs on this machine.\n"
STATES = (
    "By number of manipulations before the state. *no action* takes the state before the last manipulation as the "
    "estimate.\n"
)
HYPOTHESES = (
    "VtM answers with several hypotheses of the shape, of which the chosen one is the most probable after their "
    "refinement. *several*: share of states with more than one that is distinct (at least 0.05 away from the chosen "
    "one, and of a probability of at least 0.02). *probability*: mean, of the chosen one. *error*: mean error of the "
    "chosen refined mesh; *best*: of the distinct hypothesis that is nearest to the truth, which nobody can know "
    "beforehand; what lies between them is lost by the choice. The columns *.._several* count the states with several "
    "alone.\n"
)
ATTEMPTS = "Tried sequences by result: accepted, or the reason for the rejection.\n"
FAILURES = (
    "On the test set; the first plan of each session and its outcome. *search_failure*: share of plans with a higher "
    "loss than the recorded manipulations, which the search therefore missed. *model_failure*: share of plans with no "
    "higher loss, but an outcome with an error above 0.05. *layers_reversed*: share of outcomes with the goal's folds, "
    "but with more than a quarter of the layers in another order (to fold twice, but over the other axis first, "
    "reverses half of them). *grasp_offered*: share of starts with a candidate grasp point at each recorded grasp "
    "point. *nulls_fired*: manipulations per session that the planner cancelled, because it expected that the plan "
    "would not bring the cloth nearer to the goal. *nulls_helped*: of those in the last step of a session, the share "
    "that would have moved the cloth away from the goal, in a simulation of the cancelled manipulation. *expected*, "
    "*error*: mean error that the nets predict, and mean error of the outcome. *error_estimate_good*, "
    "*error_estimate_bad*: mean error of the tasks whose first estimate has an error of at most 0.05, and of the "
    "others. The CSV also has the training set.\n"
)
LARGEST = (
    "The test tasks with the largest errors, and their diagnosis in the terms of the paper's section 6.4. The "
    "diagnosis is the first that applies: a recorded grasp point had no candidate nearby (*grasp point not offered*); "
    "the first estimate had an error above 0.05 (*estimate wrong*); more than a quarter of the estimate's layers are "
    "in another order than the true ones (*estimate's layers reversed*), or of the final outcome's in another order "
    "than the goal's (*layers reversed*); the recorded manipulations have a lower loss than the plan (*search "
    "failure*); the nets expected an error of at most 0.05 (*model failure*); none of these (*open*): the nets "
    "expected a larger error, and do not rate the recorded manipulations better. All columns except *error* and "
    "*layers_reversed* are about the first plan; what happened later in the session is not diagnosed.\n"
)
CAMERA = (
    "Test cloths in front of a simulated depth camera (section 6.5). *tilt* is the camera's angle from straight down, "
    "in degrees; *noise* is a multiple of the noise and holes of a first-generation Kinect. Point clouds are processed "
    "like those of a user: the table is found, the cloth is cut out, and voxels are centred where the cloth was seen. "
    "The condition *voxels* is that of all other tables: noise-free voxels of the true mesh.\n"
)
CAMERA_ESTIMATION = (
    "Means over states after one, two and three manipulations. *seen*: share of states whose picture shows a cloth. "
    "*voxel_error*: mean difference to the noise-free voxels. *centre_error*: distance of the observed centre from the "
    "true one, and *estimate*: error of the refined estimate, both in lengths of the cloth's side. *iou*: intersection "
    "over union of the point cloud's silhouette and the true one. *alarm*, where alarms are set: share of the seen "
    "states that raise one.\n"
)
DOUBT = (
    "What the planner knows of its own ignorance, on the validation split. Probes are manipulations that were executed "
    "to learn where the forward models are wrong: *recorded* ones, hands at the cloth's corners with any displacement "
    "(*displaced*), hands anywhere (*grasped*), and *random* plans of three manipulations as searches start from. The "
    "error is that of the mean of the nets' predictions from the true start.\n"
)
DOUBT_MEASURES = (
    "How well each measure tells the errors of probes, with 95 % intervals over sequences (bootstrap): over all, over "
    "single manipulations from each state, and over the first, second and third manipulation of plans. The dashed line "
    "is what a measure comes to that tells nothing."
)
DOUBT_TABLE = (
    "*wrong*: area under the ROC curve for telling errors above 0.08 from those below; *off_support*: for telling "
    "probes from recorded manipulations and the first ones of random plans; *rank*: Spearman's correlation with the "
    "error. Measures: u of eq. (15) in *deviations*; the same in deviations of plans on the support of the very state, "
    "in logarithms (*conditional*); the *distance* of the nets' predictions; their *sigma*; the "
    "*surprise* of the support model, which tells recorded manipulations from random ones; and the *expected* error, a "
    "map from distance, sigma and surprise that was fitted to the other sequences' probes. Intervals: "
    "[doubt_intervals.csv](tables/doubt_intervals.csv).\n"
)
TRUST_PICTURED = (
    "Expected against real errors, in lengths of the cloth's side: at the left those of the probes' predictions, at "
    "the right the distances of plans' outcomes from their goals, of validation plans that were executed to their end. "
    "Each is expected by a map that was fitted to the other sequences. The band is the interval that is told, in the "
    "median."
)
TRUST = (
    "Validation plans by their *trust*: the share of plans with such an expectation that end at most 0.05 lengths of "
    "the cloth's side from their goals, as the other sequences' plans tell it. *expected*, *error*: mean expected and "
    "real distance from the goal. *trusted*, *came_true*: mean trust, and the share that did end so near. *inside*: "
    "share of errors (below 0.001 they count as 0.001) inside the interval that is told with a plan, which shall hold "
    "80 %.\n"
)
GOALS = (
    "The field's standard folds, made in the simulator without a planner (`clothkit goals`), as goals. Each is planned "
    "for with as many manipulations as it needs, with at least three from a crumpled cloth: with *b1* from true meshes "
    "(source *mesh*), and with *main* before a depth camera (source *camera*). Cloths begin flat, dragged over the "
    "table, or crumpled, by a hand that lets them fall; each lies at another angle, and its goal with it. *script*: "
    "nothing is planned, the goal's own folds are executed; what is left is due to hands that are faster than those "
    "that made the goal, and may grasp one layer alone. Plans have at most three manipulations; for a goal of more, "
    "another plan follows. Of so few cloths (*cloths*), means are rough: *_std* is the standard deviation over them.\n"
)
GOALS_ERROR = "Mean errors of outcomes, by how the cloth lay at first.\n"
GOALS_SOFTGYM = (
    "The measure of SoftGym's FoldCloth, of which its reward is the negative: the mean distance of each point that is "
    "moved from the one on which it shall lie, and 1.2 times the mean displacement of the latter from where the flat "
    "cloth has them. Unlike the error, it counts where on the table the cloth lies.\n"
)
GOALS_IOU = "Mean intersection over union of the silhouettes of outcome and goal, both centred.\n"
GOALS_PICTURED = (
    "The first cloth, turned back by the angle at which it lay. At the left each goal; then, by how the cloth lay at "
    "first (white), the outcomes of plans from each source (light blue)."
)
BY_CLOTH = (
    "Mean errors on the test set by the cloth's thickness, in percent of its longer side, by the ratio of its sides, "
    "and by how it lay at first: flat, dragged over the table by a hand, or dropped. Columns 1, 2, 3: estimates after "
    "so many manipulations, and plans of so many. *sequences* is the number of sequences.\n"
)
CAMERA_PLANNING = (
    "The same tasks under every condition, planned by *main*. Estimates and grasp positions are from the camera's "
    "point clouds. Columns 1, 2, 3: mean error of outcomes by number of manipulations. *iou*: intersection over union "
    "of the true silhouettes of outcome and goal; *iou_seen*: of the outcome's silhouette as the camera sees it and "
    "the goal's.\n"
)
CAMERA_COMPARISONS = (
    "Each condition compared with *voxels* on the same tasks: mean difference of errors (above zero, errors are larger "
    "with the camera), its 95 % bootstrap interval, and p of a two-sided paired sign-flip test, both over sequences. "
    "Interval and p are not given for fewer than ten sequences.\n"
)
PLAN_LENGTH = (
    "The agent may choose how many manipulations are worth it (section 8 of the paper; `clothkit plan --steps auto`), "
    "three at most. Here all tasks were also run with one, two and three manipulations, whatever number their goals "
    "were recorded with.\n"
)
PLAN_LENGTH_PICTURED = (
    "Mean error of the outcomes against the mean number of executed manipulations, by the number with which the goals "
    "were recorded. Lines join sessions of one, two and three manipulations; a diamond marks those in which the agent "
    "chose, with the 95 % interval of their error, a ring those with the recorded number, and a cross the error of "
    "doing nothing."
)
PLAN_LENGTH_TABLE = (
    "Sessions in which the agent chose (*chosen*) and those with the recorded number (*given*), by that number, over "
    "all starts. *used*: mean number of executed manipulations. *difference*: mean error of *chosen* minus that of "
    "*given* on the same tasks (below zero, choosing is better), with its 95 % bootstrap interval and p of a two-sided "
    "paired sign-flip test, both over sequences.\n"
)
MARGINS = (
    "By how much nearer to the goal each manipulation beyond the first has to be expected to bring the cloth, in "
    "lengths of the cloth's side: what each margin would have come to on validation tasks. *chosen*: the largest "
    "margin whose mean error is within one standard error of the lowest; *difference* and *standard_error* are "
    "relative to that.\n"
)
PLAN_WAYS = (
    "Validation plans that were cut from a plan of three manipulations (*cut*), which was searched for with a loss "
    "over all predicted states, as section 8 of the paper proposes, and plans of as many manipulations that were "
    "searched for themselves (*own*), by the number with which the goals were recorded. *expected*: mean predicted "
    "distance from the goal; *error*: that of the outcome, executed without a look in between. *difference*: *cut* "
    "minus *own*.\n"
)
REACH = (
    "Plans whose hands have to stay within a region, for validation tasks and a cloth of 0.4 m in the middle of the "
    "table. *square*: x and y are at most *size* (in m) from the middle; *side*: x is at least minus *size*. A plan "
    "that leaves the region is turned and mirrored by the cloth's symmetries first. That is all of the way *turning*; "
    "the way *terms* (`clothkit plan --reach`) else searches anew with reach as a term of the objective.\n"
)
REACH_PICTURED = (
    "Share of tasks with a plan that stays inside, and mean error of the outcomes, against the size of the region, "
    "with 95 % intervals over sequences. Where there is no plan, nothing is done. Dotted lines are the errors without "
    "limits and of no action."
)
REACH_TABLE = (
    "*inside*: share of tasks with a plan that stays inside; *turned*, *searched*: shares of those that came about so. "
    "*error*: mean over all tasks, of the cloth as it lies where there is no plan; *error_inside*: over tasks with a "
    "plan, and *error_free_inside* that of the plans without limits for the same tasks.\n"
)
DOUBT_TEST = (
    "Test plans by what the search minimises, executed to their end: mean errors of outcomes with 95 % intervals over "
    "sequences, by number of manipulations and, where both were tried, by the rule for first manipulations. Rings are "
    "plans without doubt, numbers below are the weight alpha of the doubt; a star marks a paired difference, to either "
    "side, to eq. (13) without doubt, which is the dotted line, with p < 0.01. A search failure, a plan with a larger "
    "loss than the recorded manipulations, is counted under each objective's own loss. "
    "[Means and differences](studies/doubt_test_summary.csv)."
)
DOUBT_AMOUNT = (
    "What doubt is worth with nets that were trained on less data, and with more nets: mean errors of the outcomes of "
    "validation plans with 95 % intervals over sequences. A star marks a paired difference to no doubt with the same "
    "nets with p < 0.01. [Means and differences](studies/doubt_amount_summary.csv)."
)
SYSTEMS = {
    "main": "observes voxels only; an ensemble of mesh nets",
    "a1": "main, from true meshes",
    "a2": "a voxel net",
    "main_occluded": "main's predictions, as a camera above would see them",
    "b1": "main, from true meshes",
    "b2": "main with one net",
    "b3": "main without the uncertainty term",
    "b4": "an ensemble of voxel nets",
    "b5": "one voxel net",
    "unrefined": "main without refinement of its estimates",
    "no action": "start compared with goal",
    "no action, occluded": "start compared with goal, as a camera above sees them",
    "pmr": "means of VtM's probabilistic mesh",
    "dmr": "the refined mesh",
}
"""Meanings of the names of systems and of kinds of estimates."""

CAPTIONS_FILE = "captions.json"
"""File beside a report's figures with the captions that they had when they were drawn."""

# Captions of figures.
SEQUENCES = (
    "Simulated test sequences, seen from above. Dotted lines are the manipulations (red and green: the two hands); "
    "blue and orange are the two sides of the cloth."
)
ESTIMATES = (
    "Estimates of test sequences after one, two and three manipulations: the true mesh, its voxels, VtM's mean with σ "
    "in lilac, and the refined mesh."
)
PREDICTIONS = (
    "Predictions from an estimate of the first state (E), beside the recorded states (R). Lilac is σ; the yellow arrow "
    "in a corner is the predicted shift of the cloth's centre, to scale."
)
CALIBRATION = (
    "Test set: the share of coordinates whose error is below z σ, against the same share of a normal distribution; "
    "dots are at z = 1. Above the dashed diagonal σ is too large for the errors, below it too small. Estimates are "
    "grouped by the number of manipulations before the state; predictions, which start from estimates, by the number "
    "of predicted manipulations, over all starts."
)
SCATTER = (
    "Planning error against prediction error; a dot is a test task. Predictions have the same input as the planner: "
    "estimates for main, true meshes (a1) for b1."
)
LARGEST_PICTURED = (
    "The largest errors, in the order of the table. On the left the start with the recorded manipulation, and the "
    "goal. Then, for each plan: the estimate with candidate grasp points (lilac circles) and the plan's first "
    "manipulation; the predicted outcome of the whole plan (σ in lilac); and the state after the execution, the final "
    "one on light blue. The numbers are the error of the first estimate, the distance from the goal that the nets "
    "expect after the first plan, and the error of the final state."
)
CAMERA_PICTURED = (
    "Test states in front of the cameras: the middle of the picture, coloured by height above the table; the resulting "
    "voxels (the scales below apply to all pictures); and the refined estimate. On the left the true mesh, its "
    "noise-free voxels, and the estimate from them."
)
MESHES = (
    "One state of the first test sequence as a mesh, and as the probabilistic mesh that VtM estimates from its voxels. "
    "Both are shown from above (with the grid drawn on the picture; lilac is σ) and as one image per component over "
    "the cloth, with u to the right and v upwards. Lighter means larger: x and y over the viewport, z over the mesh's "
    "own range of heights, σ up to the number above it."
)
VOXELS_PICTURED = (
    "The same state in voxels, without noise and occlusion: the share of occupied voxels along each line of sight; "
    "darker means more. z is stretched like the resolution of the viewport."
)
TRAJECTORIES = (
    "From grasp points g and displacement d to release points r. Two hands move in mirror symmetry at the line m, "
    "which is perpendicular to d at the point p (eq. 1); a single hand moves by d. Grey is the silhouette. In every "
    "figure, a path that leaves the picture ends in an arrow at its border."
)
EQUIVALENTS = (
    "One shape as eight equivalent meshes, with the geodesic coordinates of the corners; colours also show geodesic "
    "coordinates."
)
CURVES = (
    "Validation errors during training; dots mark the values where the score was best. Tasks: number of manipulations "
    "/ state from which they start. States: number of manipulations before the state."
)
SESSIONS = (
    "On top the recorded sequence with its goal (light blue), of which the planner is given the goal only. On the left "
    "the executed states, with the outcome in light blue. In the middle, for each plan, the estimate (E) with "
    "candidate grasp points (lilac circles) and the predictions (P, σ in lilac). On the right the predicted outcome, "
    "refined. The examples are the first test sequences and the task of median error. A path that leaves a picture "
    "ends in an arrow at its border."
)
