"""What a camera sees, and what people bring: files, point clouds, depth images -> voxels and poses (section 6.5)."""
