"""Representations of a cloth state: topology and symmetries, meshes, voxels, silhouettes."""
