"""The models: pEM*D, the voxel EM*D and VtM, what they compute, and their storage. Nothing about how they learn."""
