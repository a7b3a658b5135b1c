"""Representations of a cloth state: grid topology and equivalents, meshes, voxels, silhouettes."""
