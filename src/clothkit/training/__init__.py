"""Training: losses, augmentation, recipes, the training loop and its checkpoints (sections 4.6 to 4.8)."""
