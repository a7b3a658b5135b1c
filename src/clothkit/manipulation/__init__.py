"""What a robot can do to a cloth: the 6-vector, trajectories, grasp candidates, sampling."""
