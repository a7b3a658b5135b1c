"""What a cloth state is: grid topology and equivalents, meshes, voxels, silhouettes."""
