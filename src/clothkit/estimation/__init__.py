"""From voxels to a probabilistic mesh to a plausible mesh."""
