"""Named goals: the shapes into which the field folds cloths, made in the simulator, and how near an outcome comes."""
