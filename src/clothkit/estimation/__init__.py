"""Estimation: from voxels to a probabilistic mesh, and by refinement to a plausible mesh."""
