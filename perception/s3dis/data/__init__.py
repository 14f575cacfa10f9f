"""The rooms of S3DIS: raw files, prepared rooms, blocks, batches."""
