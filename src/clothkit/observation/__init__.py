"""Converts observations (files, point clouds, depth images) to voxels and poses (section 6.5)."""
