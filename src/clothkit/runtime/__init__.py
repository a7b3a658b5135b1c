"""How code runs: settings classes, errors in one sentence, caches, clocks, whole files, resumable work, stages."""
