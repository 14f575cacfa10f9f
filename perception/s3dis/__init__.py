"""The paper's Table 1: instance segmentation of the rooms of S3DIS."""
