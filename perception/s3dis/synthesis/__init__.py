"""Synthetic rooms in the on-disk format of S3DIS."""
