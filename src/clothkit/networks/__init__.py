"""The nets (pEM*D, the voxel EM*D and VtM), their training and their storage."""
