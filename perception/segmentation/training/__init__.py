"""Training of segmentation networks: data, losses, loop, checkpoints."""
